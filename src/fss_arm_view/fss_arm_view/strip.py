"""Strip above the live drawing: the most important state of each vehicle."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from math import degrees, isfinite, isnan, nan
from typing import Any, NamedTuple

STOPPED = 2  # bit of the flags in telemetry of links and board
TIMEOUT = 3.0  # age from which a message no longer counts [s]
ALARM_SIGMAS = 3.0  # heading difference that is an alarm, in standard deviations
NEUTRAL, POSITIVE, WARNING, ALARM = "", "good", "attention", "danger"  # styles of an item
VERDICT_STYLES = {"pass": POSITIVE, "fail": ALARM}
BASE, PROPELLANT, GRIPPER = "base", "propellant", "gripper"
HEADING = "heading, measured minus predicted"


class Item(NamedTuple):
    """One item of the strip."""

    name: str
    value: str
    style: str = NEUTRAL


class Report(NamedTuple):
    """Last diagnostics of a node."""

    error: str  # empty: none
    missed: int  # deadlines, in all
    newly_missed: int  # deadlines, since the report before
    received: float  # [s]


@dataclass
class Strip:
    """Last messages received of a vehicle; times are of a monotonic clock [s]."""

    n: int  # number of links
    links: dict[int, tuple[Any, float]] = field(default_factory=dict)  # telemetry, receive time
    pose_received: float = nan  # receive time of the base's last pose; NaN: none yet
    #: Value and receive time by item: BaseTelemetry, propellant [kg], GripperState, and the
    #: heading's difference with its sigma [rad].
    values: dict[str, tuple[Any, float]] = field(default_factory=dict)
    verdicts: dict[str, str] = field(default_factory=dict)  # by kind of calibration
    reports: dict[str, Report] = field(default_factory=dict)  # by node

    def add_report(self, node: str, error: str, missed: int, now: float) -> None:
        """Store what a node's diagnostics report: an error, if any, and missed deadlines."""
        before = self.reports[node].missed if node in self.reports else missed
        self.reports[node] = Report(error, missed, max(0, missed - before), now)

    def items(self, now: float) -> list[Item]:
        """Return all items of the strip at time `now` [s]; the node errors come last."""
        found = [*self._arm(now), *self._pose(now), *self._battery(now), *self._values(now)]
        found += [
            Item(kind, verdict, VERDICT_STYLES.get(verdict, WARNING))
            for kind, verdict in self.verdicts.items()
        ]
        recent = {
            node.lstrip("/"): report
            for node, report in self.reports.items()
            if now - report.received < TIMEOUT
        }
        late = [f"{node} {r.newly_missed}" for node, r in recent.items() if r.newly_missed]
        if late:
            found.append(Item("deadlines missed now", ", ".join(late), WARNING))
        return found + [Item(node, r.error, ALARM) for node, r in recent.items() if r.error]

    def _recent_links(self, now: float) -> dict[int, Any]:
        """Return the last telemetry of the links that still send it."""
        return {i: m for i, (m, then) in self.links.items() if now - then < TIMEOUT}

    def _arm(self, now: float) -> Iterable[Item]:
        recent = self._recent_links(now)
        if self.links and (lost := sorted(set(range(1, self.n + 1)) - recent.keys())):
            yield Item("no telemetry", f"link {_join(lost)}", ALARM)
        if stopped := sorted(i for i, m in recent.items() if m.flags & STOPPED):
            yield Item("STOPPED", f"link {_join(stopped)}", ALARM)
        if faulty := sorted(i for i, m in recent.items() if m.faults):
            yield Item("fault", f"link {_join(faulty)}", ALARM)
        armed = sum(m.armed for m in recent.values())
        text = f"{armed} of {self.n} armed" if armed else "disarmed"
        yield Item("arm", text if recent else "unknown")

    def _pose(self, now: float) -> Iterable[Item]:
        if isnan(self.pose_received):
            yield Item("motion capture", "base not seen yet", ALARM)
        elif (age := now - self.pose_received) > TIMEOUT:
            yield Item("motion capture", f"base not seen for {age:.0f} s", ALARM)

    def _battery(self, now: float) -> Iterable[Item]:
        known = {i: 0.1 * m.battery for i, m in self._recent_links(now).items() if m.battery}
        if known:
            lowest = min(known, key=lambda i: known[i])
            yield Item("lowest battery", f"{known[lowest]:.1f} V, link {lowest}")

    def _values(self, now: float) -> Iterable[Item]:
        for name, describe in DESCRIPTIONS.items():
            if name in self.values:
                value, then = self.values[name]
                if (age := now - then) > TIMEOUT:
                    yield Item(name, f"no data for {age:.0f} s", WARNING)
                elif words := describe(value):
                    yield Item(name, *words)


def _describe_base(telemetry: Any) -> tuple[str, str]:
    stopped = bool(telemetry.flags & STOPPED)
    text = "STOPPED" if stopped else "armed" if telemetry.armed else "disarmed"
    volts = f", {0.1 * telemetry.battery:.1f} V" if telemetry.battery else ""
    return text + volts, ALARM if stopped else NEUTRAL


def _describe_propellant(mass: float) -> tuple[str, str] | None:
    return (f"{1e3 * mass:.0f} g", NEUTRAL) if isfinite(mass) else None


def _describe_gripper(state: Any) -> tuple[str, str]:
    return "holds" if state.holds else "closed" if state.closed else "open", NEUTRAL


def _describe_heading(difference_and_sigma: tuple[float, float]) -> tuple[str, str] | None:
    difference, sigma = difference_and_sigma
    if not isfinite(difference):
        return None
    is_alarm = isfinite(sigma) and abs(difference) > ALARM_SIGMAS * sigma
    band = f" ± {degrees(sigma):.2f}" if isfinite(sigma) else ""
    beyond = f", beyond {ALARM_SIGMAS:.0f} sigma" if is_alarm else ""
    return f"{degrees(difference):+.2f}{band} deg{beyond}", ALARM if is_alarm else NEUTRAL


#: Functions that return text and style of a value, or None if there is nothing to show.
DESCRIPTIONS: dict[str, Callable[[Any], tuple[str, str] | None]] = {
    BASE: _describe_base,
    PROPELLANT: _describe_propellant,
    GRIPPER: _describe_gripper,
    HEADING: _describe_heading,
}


def _join(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
