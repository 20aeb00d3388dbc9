"""Fixtures that all tests share.

Every test process has a ROS domain of its own, so that runs side by side do not hear each other,
and field checks on: without them rclpy publishes nonsense for a value of the wrong type.
"""

import gc
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from running import DOMAIN, Program, wait_until

# Machines are shared: the time of one example says nothing about the code.
settings.register_profile("shared", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("shared")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests that take minutes, too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--slow"):
        return
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="needs --slow"))


@pytest.fixture(scope="session", autouse=True)
def ros_log_dir(tmp_path_factory: pytest.TempPathFactory) -> None:
    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros_log"))


@pytest.fixture(scope="session", autouse=True)
def imported() -> None:
    gc.freeze()  # what imports made is not looked at again, so that collecting takes little


@pytest.fixture(scope="session")
def domain() -> int:
    """The ROS domain of this process and of those it starts."""
    return DOMAIN


@pytest.fixture
def ros() -> Iterator[None]:
    """rclpy, initialized for one test."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()
    gc.collect()  # a node whose making failed: it lives in the traceback, and others see it


@pytest.fixture
def spin(ros: None) -> Iterator[Callable[..., Any]]:
    """spin(nodes, until, timeout=10.0): run nodes in this thread until `until()` holds.

    Returns what `until()` returned; fails at the deadline. Nodes once given are closed (if they
    have a `close`) and destroyed after the test.
    """
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor()

    def run(nodes: Any, until: Callable[[], Any], timeout: float = 10.0) -> Any:
        for node in nodes if isinstance(nodes, Iterable) else [nodes]:
            executor.add_node(node)  # adding it again changes nothing
        return wait_until(until, timeout, lambda: executor.spin_once(timeout_sec=0.02))

    yield run
    for node in executor.get_nodes():
        getattr(node, "close", lambda: None)()
        executor.remove_node(node)
        node.destroy_node()
    executor.shutdown()


@pytest.fixture
def keys_file(tmp_path: Path) -> Callable[[dict[int, bytes]], Path]:
    """keys_file({1: KEY}): a file of the links' keys."""

    def write(keys: dict[int, bytes]) -> Path:
        path = tmp_path / "keys"
        path.touch(0o600)
        path.write_text("".join(f"{link} {key.hex()}\n" for link, key in keys.items()))
        return path

    return write


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    """start(module, *args, **env): run a module's main, or MODULE:FUNCTION, as a process."""
    programs: list[Program] = []

    def begin(module: str, *args: Any, **env: str) -> Program:
        log = tmp_path / f"{len(programs)}_{module.rsplit('.', 1)[-1]}.log"
        programs.append(Program(module, args, log, env))
        return programs[-1]

    yield begin
    for program in programs:
        if program.process.poll() is None:
            program.process.kill()
            program.process.wait()
        print(f"--- {program.log.name}\n{program.output}")  # shown if the test failed
