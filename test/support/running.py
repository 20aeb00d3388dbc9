"""Processes under test, in a ROS domain that is theirs alone, and waiting for conditions."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest

from fss_rehearsal.domain import reserve

# Before anything imports rclpy. Above 101 DDS ports meet the system's ephemeral ports.
OWN = next(reserve(range(66, 102)))  # reserved for as long as it is referred to
OWN.enter()
DOMAIN = OWN.number
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"

# A range of its own, too, of ports that the system gives to nobody who asks for any.
PORTS = cycle(range(10_000 + 100 * DOMAIN, 10_100 + 100 * DOMAIN))


def free_port() -> int:
    """A port that no other test process takes, free for TCP and for UDP."""
    for port in PORTS:
        with suppress(OSError), socket.socket(type=socket.SOCK_DGRAM) as datagrams:
            datagrams.bind(("", port))
            socket.create_server(("", port)).close()
            return port
    raise AssertionError("never: PORTS has no end")


# Deadlines are stated for an idle machine. A busy one is slower; a test that passes never waits.
BUSY_FACTOR = 3.0


def wait_until(until: Callable[[], Any], timeout: float, step: Callable[[], Any]) -> Any:
    """Call `step` until `until()` is true and return that; fail at the deadline [s]."""
    deadline = time.monotonic() + BUSY_FACTOR * timeout
    while not (got := until()):
        if time.monotonic() > deadline:
            pytest.fail(f"not within {BUSY_FACTOR * timeout} s")
        step()
    return got


def memory(pid: int | str = "self") -> int:
    """Resident memory of a process, by default this one [bytes]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096


def run_command(
    *command: Any, timeout: float = 600.0, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end and return it with its output as text."""
    words = list(map(str, command))
    return subprocess.run(words, capture_output=True, text=True, timeout=timeout, **options)


class Program:
    """A process of ours under test: its output so far, and how it ended."""

    def __init__(self, module: str, args: tuple[Any, ...], log: Path, env: dict[str, str]) -> None:
        module, _, main = module.partition(":")
        main = main or "main"
        code = f"import sys; from {module} import {main}; sys.exit({main}())"
        self.log = log
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-c", code, *map(str, args)],
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **env},
            )

    @property
    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def wait(self, timeout: float = 20.0) -> int:
        """Wait for the end and return the exit code."""
        try:
            return self.process.wait(BUSY_FACTOR * timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running after {BUSY_FACTOR * timeout} s:\n{self.output}")

    def stop(self, how: int = signal.SIGTERM, timeout: float = 20.0) -> int:
        """Send a signal and return the exit code (negative: the signal killed it)."""
        self.process.send_signal(how)
        return self.wait(timeout)
