"""Run a node as a program: start, spin, end with a truthful exit code."""

import atexit
import faulthandler
import gc
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import rclpy
from rclpy.exceptions import NotInitializedException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from fss_arm_ros import duplicates, memory, realtime
from fss_arm_ros.command_line import in_words
from fss_arm_ros.events import log_event
from fss_arm_ros.lockstep import report_reached_time
from fss_arm_ros.rclpy_compat import RCLError, UnknownROSArgsError
from fss_arm_ros.subscription_set import relax_events

MAX_DOMAIN = 232  # the ports of a higher one do not exist
MAX_CLOSE_TIME = 30.0  # of all nodes [s]
MAX_SHUTDOWN_TIME = 5.0  # after all nodes are closed [s]
SWITCH_INTERVAL = 0.0005  # between Python's threads: a stop waits no longer for a computation [s]
ROS_FLAGS = ("-p", "--param", "-r", "--remap", "--params-file", "--log-level", "--enclave")
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def run(
    make_node: Callable[..., Node | Sequence[Node]],
    args: Sequence[str] | None = None,
    takes: str = "",
) -> int:
    """Create a node, spin it until a signal or SystemExit ends it, and clean up.

    A callback ends the node by raising SystemExit with a code or a reason. If the node has a method
    `close()`, it is called before the node is destroyed. If the node has a job to finish, its
    method `unfinished()` returns the progress, or an empty string when done. A node does not start
    beside another one with the same name or services unless `allow_duplicate` is set.

    Args:
        make_node: the node's class, or a function that returns one node or several; called with the
            plain arguments.
        args: the command line (default sys.argv).
        takes: plain arguments for the usage line, such as `BAG...`; empty: none are accepted.

    Returns:
        The exit code: 0 after SIGINT, SIGTERM or shutdown, but 130 if they interrupted a job; 1 if
        the node cannot be created (its ValueError or OSError is printed in one line), 2 for a wrong
        command line. While nodes close, further SIGINTs are ignored. If a node or the middleware
        blocks then, the process ends with 1 and a traceback.
    """
    argv = list(sys.argv if args is None else args)
    name = argv[0].rsplit("/", 1)[-1]
    try:
        plain = remove_ros_args(argv)[1:]
    except UnknownROSArgsError as error:
        return _failed(name, f"{error} is not understood after --ros-args", 2)
    except RCLError as error:
        return _failed(name, _argument_problem(error), 2)
    if plain and not takes:
        return _failed(name, f"{plain[0]!r} is not understood; {_next_step(plain[0])}", 2)
    try:
        check_domain()
    except ValueError as error:
        return _failed(name, error, 2)
    not_permitted = _tune_process()
    nodes: Sequence[Node] = ()
    executor: SingleThreadedExecutor | None = None
    initialized = False
    try:
        signal.signal(signal.SIGINT, _interrupt_next)
        rclpy.init(args=argv)
        initialized = True
        if signal.getsignal(signal.SIGINT) is not _interrupt_next:
            raise KeyboardInterrupt  # received before rclpy could handle it
        with duplicates.looking():
            made = make_node(*plain)
            nodes = made if isinstance(made, Sequence) else [made]
            duplicates.check_services(nodes)
            report_reached_time(nodes[0])
            for line in not_permitted:
                nodes[0].get_logger().warning(line)
                log_event(nodes[0], f"{nodes[0].get_name()}: {line}")
            executor = SingleThreadedExecutor()
            for node in nodes:
                relax_events(node)
                executor.add_node(node)
            executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SystemExit as end:
        if isinstance(end.code, str):
            return _failed(name, end.code, 1)
        return end.code or 0
    except (RCLError, NotInitializedException) as error:
        # A context that a signal has shut down raises these in any call.
        if rclpy.ok() or not initialized:
            if nodes:
                raise
            return _failed(name, error, 2)
    except (ValueError, OSError, ParameterException) as error:
        if nodes and not isinstance(error, duplicates.DuplicateError):
            raise
        if (
            rclpy.ok() or not initialized
        ):  # an action raises ValueError in a context that is shut down
            return _failed(name, error, 1)
    finally:
        # A thread that waits in rclpy when Python ends aborts the process (ros2/rclpy issue 1484).
        # So nothing may keep the nodes from ending their threads.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        faulthandler.dump_traceback_later(MAX_CLOSE_TIME, exit=True, file=2)
        for node in nodes:
            getattr(node, "close", lambda: None)()
        # Fast DDS 2.14 sometimes blocks indefinitely when many processes end at the same time.
        faulthandler.dump_traceback_later(MAX_SHUTDOWN_TIME, exit=True, file=2)
        if executor:
            executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGINT, signal.default_int_handler)
    left = [words for node in nodes if (words := getattr(node, "unfinished", str)())]
    return _failed(name, f"interrupted {'; '.join(left)}", 130) if left else 0


def check_domain() -> None:
    """Check the ROS domain of this process's environment.

    rcl would report only what is no number, and the middleware would try ports that do not exist.

    Raises:
        ValueError: ROS_DOMAIN_ID is not a whole number from 0 to MAX_DOMAIN.
    """
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (given.isascii() and given.isdecimal() and int(given) <= MAX_DOMAIN):
        raise ValueError(
            f"ROS_DOMAIN_ID is {given!r}, expected a whole number from 0 to {MAX_DOMAIN}"
        )


def _argument_problem(error: RCLError) -> str:
    """Return what rcl says of a command line, without places in its source and its parser."""
    words = str(error).split(", at /")[0]
    if rule := re.search(r"(override|remap) rule: '(.*?)'", words):
        form = "-p NAME:=VALUE" if rule[1] == "override" else "-r NAME:=NEW_NAME"
        return f"{rule[2]!r} is not understood, expected {form}"
    return words


def _next_step(argument: str) -> str:
    """Return what to do about a plain argument that a node does not take."""
    if argument in ROS_FLAGS:
        return f"give it after --ros-args: --ros-args {argument} ..."
    return f"give it as --ros-args -p {argument}" if ":=" in argument else "try --help"


def _tune_process() -> list[str]:
    """Apply settings of the whole process, which no library should change.

    Returns:
        What the system did not permit, a line each.
    """
    memory.bound()
    sys.setswitchinterval(SWITCH_INTERVAL)
    atexit.register(gc.freeze)  # else the interpreter collects garbage at exit, 0.25 s with numba
    return realtime.apply()


def _interrupt_next(*_: object) -> None:
    """Leave the first SIGINT to rclpy, which shuts the context down; the next one interrupts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def spin_once(node: Node, timeout: float) -> None:
    """Spin a command's node once; handle signals afterwards.

    An exception raised by a signal handler inside rclpy's extension would become a TypeError.

    Args:
        node: the node to spin.
        timeout: longest wait [s].
    """
    with deferred_signals():
        rclpy.spin_once(node, timeout_sec=timeout)


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Handle the signals that end a process only at the end of this context."""
    received: list[int] = []
    # Other signals are ignored, as under nohup, or end the process.
    handlers = {number: by for number in END_SIGNALS if callable(by := signal.getsignal(number))}
    for number in handlers:
        signal.signal(number, lambda which, _: received.append(which))
    try:
        yield
    finally:
        for number, by in handlers.items():
            signal.signal(number, by)
    for which in received:
        signal.raise_signal(which)


def _failed(name: str, reason: object, code: int) -> int:
    print(f"{name}: {in_words(reason)}", file=sys.stderr)
    return code
