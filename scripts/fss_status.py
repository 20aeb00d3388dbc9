"""Show nodes, links, rates, faults and verdicts at a glance.

Exit code 0: every node runs or ended with success, and none reports an
error; 1: otherwise; 2: the ROS domain is invalid; 130: interrupted.
"""

import argparse
import fcntl
import os
import re
import sys
import time
from collections.abc import Callable, Iterable
from math import isnan
from pathlib import Path
from textwrap import fill

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.command_line import INTERRUPTED
from fss_arm_ros.run import check_domain
from fss_arm_ros.source_version import source_version
from fss_arm_ros.timing import MISSED, percentile_names
from fss_listener import Listener

MAX_EVENTS = 5  # shown
SESSION_START = "nodes are started: "  # this event starts a session; older events are not shown
LOG_PREFIX = re.compile(r"\[\w+\] \[[\d.]+\] (?=\[)")  # level and time of a ROS log
LOG_TAIL = 4096  # part of a node's log that is searched for its last line [bytes]
LEVELS = {
    DiagnosticStatus.OK: ("ok", "green"),
    DiagnosticStatus.WARN: ("warning", "yellow"),
    DiagnosticStatus.ERROR: ("ERROR", "bold red"),
    DiagnosticStatus.STALE: ("stale", "yellow"),
}
UNKNOWN_LEVEL = "unknown", "bold red"
STATES = {
    "up": "green",
    "starting": "yellow",
    "ended": "",
    "stopped": "bold red",
    "failed": "bold red",
    "down": "bold red",
}
LOST = ("stopped", "failed", "down")
VERDICTS = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold yellow"}


class Processes:
    """Node processes of a configuration, found by the locks that they hold."""

    def __init__(self, logs: Path, names: list[str], mute: list[str]) -> None:
        self.logs, self.names, self.mute = logs, [*names, *mute], mute

    def state(self, name: str) -> str:
        """Return one of STATES."""
        node, keeper = (self.logs / f"{name}.{role}" for role in ("node", "keep"))
        if self._is_locked(node):
            return "up"
        if self._is_locked(keeper):
            return "starting"
        last = keeper.read_text().strip() if keeper.exists() else ""
        return last if last in STATES else "down"

    def age(self, name: str) -> float:
        """Return the time since the node's start [s]."""
        return time.time() - (self.logs / f"{name}.node").stat().st_mtime

    def events(self) -> list[str]:
        """Return the last events for the operator since the nodes were started."""
        log = self.logs / "events.log"
        lines = log.read_text(errors="replace").splitlines() if log.exists() else []
        start = max((k for k, line in enumerate(lines) if SESSION_START in line), default=0)
        return lines[start:][-MAX_EVENTS:]

    def last_log_line(self, name: str) -> str:
        """Return the last line of a node's log, which says why it has failed."""
        log = self.logs / f"{name}.log"
        if not log.exists():
            return ""
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - LOG_TAIL))
            lines = file.read().decode(errors="replace").splitlines()
        line = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return LOG_PREFIX.sub("", line)

    @staticmethod
    def _is_locked(path: Path) -> bool:
        try:
            with path.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except FileNotFoundError:
            return False
        except BlockingIOError:
            return True
        return False


def screen(processes: Processes, listener: Listener) -> Group:
    """Return all tables, to be printed by rich."""
    parts = [node_table(processes, listener), link_table(listener), rate_table(listener)]
    parts += [timing_table(listener), verdict_table(listener)]
    if not listener.reports and not listener.measured:
        domain = os.environ.get("ROS_DOMAIN_ID") or 0
        parts.append(_table(f"no node reports in ROS domain {domain}", rows=[[""]]))
    parts.append(version_table(listener))
    if events := processes.events():
        parts.append(_table("event", rows=([escape(line)] for line in events)))
    return Group(*(part for part in parts if part.row_count))


def node_table(processes: Processes, listener: Listener) -> Table:
    """Return the table of processes and their reports."""
    table = _table("node", "process", "health", "")
    others = sorted(name for name in listener.reports if name not in processes.names)
    for name in [*processes.names, *others]:
        state = processes.state(name) if name in processes.names else "elsewhere"
        shown = f"up {_duration(processes.age(name))}" if state == "up" else state
        status = listener.report(name)
        report = escape(status.message) if status else ""
        if state in LOST:  # what reports under this name is another process
            elsewhere = "another process reports under this name; " if status else ""
            why = processes.last_log_line(name) if state != "stopped" else ""
            status, report = None, escape(elsewhere + why)
        word, tone = LEVELS.get(status.level, UNKNOWN_LEVEL) if status else ("", "")
        if state == "up" and not status and name not in processes.mute:
            report = "runs, has not reported: it is starting, or the node has another name"
        table.add_row(name, _style(shown, STATES.get(state, "")), _style(word, tone), report)
    return table


def link_table(listener: Listener) -> Table:
    """Return the table of the links' electronics."""
    table = _table(
        *("link", "state", ">joint\n[deg]", ">current\n[A]", ">battery\n[V]", ">drive\n[deg C]"),
        *(">rate\n[Hz]", ">round\ntrip\n[ms]", ">faults"),
    )
    for topic, received in sorted(listener.measured.items()):
        if received.kind is not LinkTelemetry or not received.recent:
            continue
        m = received.messages()[-1]
        link = topic.rpartition("/")[0]
        q = listener.angles(link.rpartition("/")[0]).get(f"joint_{m.link}")
        table.add_row(
            link.lstrip("/"),
            _link_state(m, received.rate()),
            "" if q is None else f"{round(q, 1) + 0.0:.1f}",  # -0.0 is shown as 0.0
            f"{0.01 * m.current:.2f}",  # in 0.01 A
            f"{0.1 * m.battery:.1f}" if m.battery else "-",  # in 0.1 V; 0: not reported yet
            str(m.temperature),
            f"{received.rate():.1f}",
            "-" if isnan(m.round_trip) else f"{1e3 * m.round_trip:.0f}",
            _style(f"{m.faults:#x}", "bold red") if m.faults else "none",
        )
    return table


def _link_state(m: LinkTelemetry, rate: float) -> str:
    if not rate:
        return _style("silent", "bold red")
    if m.armed:
        return _style("armed", "bold yellow")
    if m.flags & State.STOPPED:
        return _style("stopped", "bold red")
    return "disarmed" if m.flags & State.REFERENCED else _style("not homed", "yellow")


def rate_table(listener: Listener) -> Table:
    """Return the table of the rates of measurements."""
    table = _table("topic", ">rate [Hz]")
    for topic, received in sorted(listener.measured.items()):
        if received.kind is not LinkTelemetry:
            rate = received.rate()
            table.add_row(topic, f"{rate:.1f}" if rate else _style("silent", "yellow"))
    return table


def timing_table(listener: Listener) -> Table:
    """Return the table of periods, and of latencies from a measurement to the command."""
    table = _table(
        *("timing [ms]", ">period\nmedian", ">99 %", ">99.9 %"),
        *(">latency\nmedian", ">99 %", ">99.9 %", ">missed\ndeadlines"),
    )
    keys = [*percentile_names("period"), *percentile_names("latency")]
    for name in sorted(listener.reports):
        status = listener.report(name)
        values = {value.key: value.value for value in status.values} if status else {}
        if MISSED in values:
            cells = [_rounded(values.get(key, "")) for key in keys]
            table.add_row(name, *cells, escape(values[MISSED]))
    return table


def verdict_table(listener: Listener) -> Table:
    """Return the table of the calibrations."""
    table = _table("result", "verdict", "reason")
    for topic, received in sorted(listener.results.items()):
        if received.recent:
            message = received.messages()[-1]
            m = getattr(message, "calibration", message)
            table.add_row(topic, _style(m.verdict, VERDICTS.get(m.verdict, "")), escape(m.reason))
    return table


def version_table(listener: Listener) -> Table:
    """Return the table of the workspace's commit, and of each law with the hash of its file."""
    table = _table("source", "version")
    table.add_row("commit", source_version())
    for name in sorted(listener.reports):
        status = listener.report(name)
        values = {value.key: value.value for value in status.values} if status else {}
        if "law" in values:
            table.add_row(escape(values["law"]), escape(values.get("hash of its file", "")))
    return table


def summary(problems: list[str], logs: str) -> str:
    """Return problems in one sentence, in which nodes with the same problem are grouped."""
    nodes: dict[str, list[str]] = {}
    for problem in problems:
        name, _, what = problem.partition(" ")
        nodes.setdefault(what, []).append(name)
    several = {"reports an error": "report errors", "does not report": "do not report"}
    found = []
    for what, names in nodes.items():
        words = what if len(names) == 1 else several.get(what, what.replace("is ", "are ", 1))
        found.append(f"{', '.join(names)} {words}")
    return f"not healthy: {'; '.join(found)}; logs: {logs}"


def problems(processes: Processes, listener: Listener) -> list[str]:
    """Return why nodes are not healthy; empty: each reports no error, or exited with success."""
    found = []
    for name in processes.names:
        state = processes.state(name)
        if state not in ("up", "ended"):
            found.append(f"{name} is {state}")
        elif state == "up" and not listener.report(name) and name not in processes.mute:
            found.append(f"{name} does not report")
    for name in sorted(listener.reports):
        status = listener.report(name)
        if status and status.level == DiagnosticStatus.ERROR:
            found.append(f"{name} reports an error")
    return found


def is_healthy(processes: Processes, listener: Listener) -> bool:
    """Return True if every node reports or exited successfully, and none reports an error."""
    return not problems(processes, listener)


def is_final(processes: Processes, listener: Listener) -> bool:
    """Return True if all nodes are healthy, or cannot become so because one is down."""
    down = any(processes.state(name) in LOST for name in processes.names)
    return down or is_healthy(processes, listener)


def wait_for_health(
    processes: Processes,
    listener: Listener,
    patience: float,
    listen: Callable[[float], None],
    now: Callable[[], float] = time.monotonic,
) -> None:
    """Wait until all nodes are healthy or one is down.

    On a slow computer nodes start one after the other: give up `patience` seconds after the last
    improvement.

    Args:
        processes: the nodes' processes.
        listener: receives the nodes' reports.
        patience: longest time without improvement [s].
        listen: receives reports for a time [s].
        now: reads a clock [s].
    """
    fewest, deadline = len(problems(processes, listener)), now() + patience
    while now() < deadline and not is_final(processes, listener):
        listen(0.1)
        if (count := len(problems(processes, listener))) < fewest:
            fewest, deadline = count, now() + patience


def _table(*headings: str, rows: Iterable[list[str]] = ()) -> Table:
    """Return a table; a heading that starts with `>` marks a column of numbers."""
    table = Table(box=box.SIMPLE, pad_edge=False, collapse_padding=True)
    for heading in headings:
        table.add_column(
            escape(heading.lstrip(">")), justify="right" if heading.startswith(">") else "left"
        )
    for row in rows:
        table.add_row(*row)
    return table


def _rounded(text: str) -> str:
    try:
        return f"{float(text):.1f}"
    except ValueError:  # any node may report anything
        return ""


def _style(text: str, style: str) -> str:
    return f"[{style}]{text}[/]" if style else text


def _duration(seconds: float) -> str:
    minutes, s = divmod(int(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours} h {m} min" if hours else f"{m} min {s} s" if m else f"{s} s"


def arguments() -> argparse.ArgumentParser:
    """Return the parser of the command line that fss_status.sh passes."""
    parser = argparse.ArgumentParser("fss_status.sh", description=__doc__.replace("\n\n", "\n"))
    parser.add_argument("--watch", action="store_true", help="update until interrupted")
    parser.add_argument(
        "--wait",
        type=float,
        default=1.0,
        help="wait until all nodes are healthy or one is down, at most this long since another one "
        "became healthy [s]",
    )
    parser.add_argument("--namespace", default="", help="of the vehicle to show; all by default")
    parser.add_argument("--logs", type=Path, required=True, help="folder of the nodes' logs")
    parser.add_argument(
        "--mute", action="append", default=[], metavar="NODE", help="one that reports nothing"
    )
    parser.add_argument("names", nargs="*", metavar="NODE", help="as in the configuration")
    return parser


def main() -> int:
    """Show the status once, or until interrupted; return the exit code."""
    options = arguments().parse_args()
    processes = Processes(options.logs, options.names, options.mute)
    console = Console(highlight=False)
    try:
        check_domain()
    except ValueError as error:
        print(f"fss_status.sh: {error}", file=sys.stderr)
        return 2
    rclpy.init()
    listener, executor = Listener(options.namespace), SingleThreadedExecutor()
    executor.add_node(listener)

    def listen(seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)

    try:
        if options.watch:
            with Live(console=console, screen=True, auto_refresh=False) as live:
                while True:
                    live.update(screen(processes, listener), refresh=True)
                    listen(1.0)
        wait_for_health(processes, listener, options.wait, listen)
        listen(1.0)  # for the rates
        console.print(screen(processes, listener))
        if found := problems(processes, listener):
            line = summary(found, str(options.logs))
            print(fill(line, 80, break_long_words=False, break_on_hyphens=False), file=sys.stderr)
        return 1 if found else 0
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0 if options.watch else INTERRUPTED
    finally:
        listener.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
