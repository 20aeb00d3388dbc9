"""Processes of a rehearsal: started like `ros2 run`, restarted when killed, stopped in order."""

import signal
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Self

import rclpy
from ament_index_python.packages import get_package_prefix

from fss_rehearsal.domain import CONFIG, Domain

MAX_STARTS = 5  # starts of one node; a node that dies more often is faulty
#: Leader of the process group of all nodes. It terminates the group when its standard input closes,
#: that is when the supervisor has ended, by any signal. Processes that are stopped or that ignore
#: SIGTERM are killed 3 s later.
LEADER = "trap '' TERM INT HUP; cat; kill -TERM 0; sleep 3; kill -KILL 0"


class RehearsalError(RuntimeError):
    """Error after which the rehearsal cannot continue; the message gives the reason."""


class Nodes:
    """Node processes, each with its log; on exit all are stopped, the last one first.

    They also end when this process ends, for any reason. Signals of the terminal do not reach them.
    """

    def __init__(self, logs: Path, log_line: Callable[[str], None], domain: Domain) -> None:
        self.logs = logs
        self.log_line = log_line
        self.domain = domain
        self.commands: dict[str, list[str]] = {}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.starts: dict[str, int] = {}
        logs.mkdir(parents=True, exist_ok=True)
        self.leader = subprocess.Popen(
            ["/bin/sh", "-c", LEADER],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            process_group=0,
        )

    def start(self, name: str, package: str, executable: str, **parameters: object) -> None:
        """Start `executable` as `ros2 run` does, under the name `name`."""
        path = Path(get_package_prefix(package), "lib", package, executable)
        self.run(name, [str(path)], **parameters)

    def run(self, name: str, command: list[str], **parameters: object) -> None:
        """Start a command with a node's parameters, under the name `name`."""
        command = [*command, "--ros-args", "--enclave", self.domain.enclave]
        for key, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else value
            command += ["-p", f"{key}:={text}"]
        self.commands[name] = command
        self._start(name)

    def _start(self, name: str) -> None:
        self.starts[name] = self.starts.get(name, 0) + 1
        with (self.logs / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                # Linux sends SIGHUP to an orphaned process group of which a process is stopped.
                ["nohup", *self.commands[name]],
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                process_group=self.leader.pid,
            )

    def restart_killed(self) -> None:
        """Restart each node that was killed; a node that exits with an error ends the rehearsal.

        Raises:
            RehearsalError: a node exited with an error, or was killed too often.
        """
        self.check_alive()
        for name, process in self.processes.items():
            code = process.poll()
            if code is None or code == 0:
                continue
            if self.starts[name] >= MAX_STARTS:
                raise self.exit_of(name, code)
            self.log_line(f"node {name} was killed ({signal.Signals(-code).name}), restarting it")
            self._start(name)

    def check_alive(self) -> None:
        """Raise RehearsalError if a node exited with an error; it may have been killed."""
        for name, process in self.processes.items():
            if code := max(process.poll() or 0, 0):
                raise self.exit_of(name, code)

    def exit_of(self, name: str, code: int) -> RehearsalError:
        """Return the error for a node that has exited."""
        return RehearsalError(f"node {name} exited with code {code}: {self.last_log_line(name)}")

    def last_log_line(self, name: str) -> str:
        """Return the last line of the node's log, and the log's path."""
        log = self.logs / f"{name}.log"
        lines = log.read_text(errors="replace").splitlines() or ["empty"]
        return f"{lines[-1]} (see {short_path(log)})"

    def overdue(self, name: str, deadline: float) -> RehearsalError:
        """Return the error for a node that has not finished its job by a deadline [s]."""
        return RehearsalError(
            f"node {name} is not finished after {deadline:.0f} s; on a busy computer raise "
            f"--deadline; its log: {self.last_log_line(name)}"
        )

    def has_finished(self, name: str) -> bool:
        """Return True if the node has exited with code 0."""
        return self.processes[name].poll() == 0

    def stop(self, name: str, timeout: float = 10.0) -> None:
        """Interrupt one node and wait until it has exited; kill it after the timeout [s]."""
        process = self.processes[name]
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.log_line(f"node {name} does not stop within {timeout:g} s, killing it")
            process.kill()
            process.wait()
        del self.processes[name]

    def close(self) -> None:
        """Stop all nodes, the last one first."""
        try:
            for name in reversed(list(self.processes)):
                self.stop(name)
            self.leader.kill()  # no process is left that it would have to terminate
        finally:
            self.leader.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def short_path(path: Path) -> Path:
    """Return a path as messages show it: relative to the working directory if it is below it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def results(folder: Path | None, name: str) -> Path:
    """Return the folder for results: the given one, or a new one named `name` and time in out/.

    Raises:
        RehearsalError: the folder exists already.
    """
    new = CONFIG.parent / "out" / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    out = (folder or new).absolute()
    if out.exists():
        raise RehearsalError(f"{short_path(out)} exists: choose another folder with --out")
    return out


def rehearse(name: str, run: Callable[[], int]) -> int:
    """Run a rehearsal; return its exit code: 1 after an error, 128 + number after a signal."""
    signals: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        signals.append(number)
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)
    try:
        return run()
    except (KeyboardInterrupt, Exception) as error:
        if signals:  # rclpy may turn the interrupt into any exception, even a TypeError
            print(f"{name}: interrupted", file=sys.stderr)
            return 128 + signals[0]
        if not isinstance(error, (RehearsalError, ValueError, OSError)):
            raise
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
