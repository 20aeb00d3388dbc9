"""Show nodes, links, rates, faults and verdicts at a glance.

Exit code 0: every node runs and none reports an error; 1: not so.
"""

import argparse
import fcntl
import os
import sys
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import degrees
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from sensor_msgs.msg import JointState

from fss_arm_bags.definitions import MEASUREMENTS, NotInstalledError, message_class
from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.subscription_set import subscribe_bytes

LOOSE = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)  # slows no publisher
SPAN = 2.0  # rates are taken over [s]
REPORT = 3.0  # older than this, a node's report says nothing of it any more [s]
EVENTS = 5  # shown
BEGUN = "nodes are started: "  # an event that those before do not belong to
TAIL = 4096  # of a node's log that its last words are looked for in [bytes]
READINGS = 64  # messages kept of joints, that a link may have one each
LEVELS = {
    DiagnosticStatus.OK: ("ok", "green"),
    DiagnosticStatus.WARN: ("warning", "yellow"),
    DiagnosticStatus.ERROR: ("ERROR", "bold red"),
    DiagnosticStatus.STALE: ("stale", "yellow"),
}
STATES = {
    "up": "green", "starting": "yellow", "ended": "",
    "stopped": "bold red", "failed": "bold red", "down": "bold red",
}  # fmt: skip
LOST = ("stopped", "failed", "down")
VERDICTS = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold yellow"}


@dataclass
class Heard:
    """What came in on a topic."""

    kind: Any
    recent: deque[bytes] = field(default_factory=lambda: deque(maxlen=READINGS))
    since: float = field(default_factory=time.monotonic)
    times: deque[float] = field(default_factory=deque)  # within the last SPAN [s]

    def take(self, data: bytes) -> None:
        """Count a message and keep it; it is read only when it is shown."""
        if self.kind is not JointState:  # each tells all
            self.recent.clear()
        self.recent.append(data)
        self.times.append(time.monotonic())

    def rate(self) -> float:
        """Messages a second."""
        now = time.monotonic()
        while self.times and self.times[0] < now - SPAN:
            self.times.popleft()
        return len(self.times) / min(SPAN, now - self.since)

    def messages(self) -> list[Any]:
        """Those that tell all together, the last one last."""
        return [deserialize_message(data, self.kind) for data in self.recent]


class Listener(Node):
    """Hears everything that is to be shown."""

    def __init__(self, namespace: str = "") -> None:
        super().__init__("status", start_parameter_services=False, enable_rosout=False)
        self.within = f"/{namespace}/".replace("//", "/")  # what all names begin with
        self.measured: dict[str, Heard] = {}
        self.results: dict[str, Heard] = {}
        self.reports: dict[str, tuple[float, DiagnosticStatus]] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_report, 100)
        self.create_timer(0.2, self.discover)

    def discover(self) -> None:
        """Listen to measurements, and to results: whatever has a verdict."""
        for topic, (msgtype, *_) in self.get_topic_names_and_types():
            if topic in self.measured or topic in self.results or not topic.startswith(self.within):
                continue
            if msgtype in MEASUREMENTS:
                self.listen(self.measured, topic, msgtype, LOOSE)
            elif msgtype.startswith("fss_arm_msgs/msg/"):
                self.listen(self.results, topic, msgtype, LATCHED)

    def listen(self, into: dict[str, Heard], topic: str, msgtype: str, qos: QoSProfile) -> None:
        """Subscribe; results are those with a verdict."""
        try:
            kind = message_class(msgtype)
        except NotInstalledError:
            return
        if into is self.results and not (hasattr(kind, "verdict") or hasattr(kind, "calibration")):
            return
        into[topic] = Heard(kind)
        subscribe_bytes(self, kind, topic, into[topic].take, qos)

    def on_report(self, message: DiagnosticArray) -> None:
        """Keep each node's last report, under its name as a configuration has it: `fss2/arm`."""
        for status in message.status:
            if status.name.startswith(self.within) or "/" not in status.name:
                self.reports[status.name.lstrip("/")] = time.monotonic(), status

    def angles(self, vehicle: str) -> dict[str, float]:
        """The joints' readings [deg], by name, of what is in a namespace: `/fss2`."""
        heard = self.measured.get(f"{vehicle}/joint_states")
        return {
            name: degrees(q)
            for message in (heard.messages() if heard and heard.rate() else ())
            for name, q in zip(message.name, message.position, strict=False)
        }

    def report(self, name: str) -> DiagnosticStatus | None:
        """What a node said of itself, unless that is long ago."""
        then, status = self.reports.get(name, (0.0, None))
        return status if time.monotonic() - then < REPORT else None


class Processes:
    """The node processes of a configuration, by the locks that they hold."""

    def __init__(self, logs: Path, names: list[str], mute: list[str]) -> None:
        self.logs, self.names, self.mute = logs, [*names, *mute], mute

    def state(self, name: str) -> str:
        """One of STATES."""
        node, keeper = (self.logs / f"{name}.{role}" for role in ("node", "keep"))
        if self._held(node):
            return "up"
        if self._held(keeper):
            return "starting"
        last = keeper.read_text().strip() if keeper.exists() else ""
        return last if last in STATES else "down"

    def age(self, name: str) -> float:
        """For how long the node is up [s]."""
        return time.time() - (self.logs / f"{name}.node").stat().st_mtime

    def events(self) -> list[str]:
        """What was said to the operator last, since nodes were started."""
        log = self.logs / "events.log"
        lines = log.read_text(errors="replace").splitlines() if log.exists() else []
        begun = max((k for k, line in enumerate(lines) if BEGUN in line), default=0)
        return lines[begun:][-EVENTS:]

    def last_words(self, name: str) -> str:
        """Of a node, by its log: why it has failed."""
        log = self.logs / f"{name}.log"
        if not log.exists():
            return ""
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - TAIL))
            lines = file.read().decode(errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    @staticmethod
    def _held(path: Path) -> bool:
        try:
            with path.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except FileNotFoundError:
            return False
        except BlockingIOError:
            return True
        return False


def screen(processes: Processes, listener: Listener) -> Group:
    """All of it, for rich to print."""
    parts = [nodes(processes, listener), links(listener), rates(listener), verdicts(listener)]
    if not listener.reports and not listener.measured:
        domain = os.environ.get("ROS_DOMAIN_ID") or 0
        parts.append(_table(f"no node is heard in ROS domain {domain}", rows=[[""]]))
    if events := processes.events():
        parts.append(_table("event", rows=([escape(line)] for line in events)))
    return Group(*(part for part in parts if part.row_count))


def nodes(processes: Processes, listener: Listener) -> Table:
    """The processes and what they say of themselves."""
    table = _table("node", "process", "health", "")
    others = sorted(name for name in listener.reports if name not in processes.names)
    for name in [*processes.names, *others]:
        state = processes.state(name) if name in processes.names else "elsewhere"
        shown = f"up {_duration(processes.age(name))}" if state == "up" else state
        status = listener.report(name)
        word, tone = LEVELS[status.level] if status else ("", "")
        said = escape(status.message) if status else ""
        if state in LOST and not said:
            said = escape(processes.last_words(name))
        if state == "up" and not status and name not in processes.mute:
            said = "runs, but no node of this name reports"
        table.add_row(name, _in(shown, STATES.get(state, "")), _in(word, tone), said)
    return table


def links(listener: Listener) -> Table:
    """The links' electronics."""
    table = _table(
        *("link", "state", ">joint\n[deg]", ">current\n[A]", ">battery\n[V]", ">drive\n[deg C]"),
        *(">rate\n[Hz]", ">delay\n[ms]", ">faults"),
    )
    for topic, heard in sorted(listener.measured.items()):
        if heard.kind is not LinkTelemetry or not heard.recent:
            continue
        m = heard.messages()[-1]
        link = topic.rpartition("/")[0]
        q = listener.angles(link.rpartition("/")[0]).get(f"joint_{m.link}")
        table.add_row(
            link.lstrip("/"),
            _link_state(m, heard.rate()),
            "" if q is None else f"{round(q, 1) + 0.0:.1f}",
            f"{0.01 * m.current:.2f}",
            f"{0.1 * m.battery:.1f}",
            str(m.temperature),
            f"{heard.rate():.1f}",
            f"{1e3 * m.round_trip:.0f}",
            _in(f"{m.faults:#x}", "bold red") if m.faults else "none",
        )
    return table


def _link_state(m: LinkTelemetry, rate: float) -> str:
    if not rate:
        return _in("silent", "bold red")
    if m.armed:
        return _in("armed", "bold yellow")
    if m.flags & State.STOPPED:
        return _in("stopped", "bold red")
    return "disarmed" if m.flags & State.REFERENCED else _in("not homed", "yellow")


def rates(listener: Listener) -> Table:
    """How often measurements come."""
    table = _table("topic", ">rate [Hz]")
    for topic, heard in sorted(listener.measured.items()):
        if heard.kind is not LinkTelemetry:
            rate = heard.rate()
            table.add_row(topic, f"{rate:.1f}" if rate else _in("silent", "yellow"))
    return table


def verdicts(listener: Listener) -> Table:
    """The calibrations."""
    table = _table("result", "verdict", "reason")
    for topic, heard in sorted(listener.results.items()):
        if heard.recent:
            message = heard.messages()[-1]
            m = getattr(message, "calibration", message)
            table.add_row(topic, _in(m.verdict, VERDICTS.get(m.verdict, "")), escape(m.reason))
    return table


def sound(processes: Processes, listener: Listener) -> bool:
    """Whether every node is up, and says so, or has ended well, and none reports an error."""
    states = {name: processes.state(name) for name in processes.names}
    heard = {name for name in listener.reports if listener.report(name)} | set(processes.mute)
    return all(
        state == "ended" or (state == "up" and name in heard) for name, state in states.items()
    ) and not any(
        status.level == DiagnosticStatus.ERROR for status in map(listener.report, heard) if status
    )


def settled(processes: Processes, listener: Listener) -> bool:
    """Whether all is well, or cannot become so, as a node is down for good."""
    down = any(processes.state(name) in LOST for name in processes.names)
    return down or sound(processes, listener)


def _table(*headings: str, rows: Iterable[list[str]] = ()) -> Table:
    """A table; a heading that begins with `>` is of numbers."""
    table = Table(box=box.SIMPLE, pad_edge=False, collapse_padding=True)
    for heading in headings:
        table.add_column(
            escape(heading.lstrip(">")), justify="right" if heading.startswith(">") else "left"
        )
    for row in rows:
        table.add_row(*row)
    return table


def _in(text: str, style: str) -> str:
    return f"[{style}]{text}[/]" if style else text


def _duration(seconds: float) -> str:
    minutes, s = divmod(int(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours} h {m} min" if hours else f"{m} min {s} s" if m else f"{s} s"


def arguments() -> argparse.ArgumentParser:
    """The command line, as fss_status.sh gives it."""
    parser = argparse.ArgumentParser("fss_status.sh", description=__doc__.replace("\n\n", "\n"))
    parser.add_argument("--watch", action="store_true", help="go on until interrupted")
    parser.add_argument(
        "--wait", type=float, default=1.0, help="until all is well or a node is down, at most [s]"
    )
    parser.add_argument("--namespace", default="", help="of the vehicle to show; all by default")
    parser.add_argument("--logs", type=Path, required=True, help="folder of the nodes' logs")
    parser.add_argument(
        "--mute", action="append", default=[], metavar="NODE", help="one that reports nothing"
    )
    parser.add_argument("names", nargs="*", metavar="NODE", help="as in the configuration")
    return parser


def main() -> int:
    """Run."""
    options = arguments().parse_args()
    processes = Processes(options.logs, options.names, options.mute)
    console = Console(highlight=False)
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
        deadline = time.monotonic() + options.wait
        while time.monotonic() < deadline and not settled(processes, listener):
            listen(0.1)
        listen(1.0)  # for the rates
        console.print(screen(processes, listener))
        return 0 if sound(processes, listener) else 1
    except KeyboardInterrupt:
        return 0
    finally:
        listener.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
