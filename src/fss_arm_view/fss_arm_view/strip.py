"""Strip above the live drawing: the most important state of each vehicle."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import degrees, isfinite, nan
from typing import Any, NamedTuple

STOPPED = 2  # State.STOPPED of docs/reference/protocol.md, in the flags of links and board
TELEMETRY_TIMEOUT = 3.0  # [s]
ALARM_SIGMAS = 3.0  # heading difference that is an alarm, in standard deviations
NEUTRAL, POSITIVE, WARNING, ALARM = "", "good", "attention", "danger"  # styles of an item
VERDICT_STYLES = {"pass": POSITIVE, "fail": ALARM}


class Item(NamedTuple):
    """One item of the strip."""

    name: str
    value: str
    style: str = NEUTRAL


@dataclass
class Strip:
    """Last messages received of a vehicle; times are of a monotonic clock [s]."""

    links: dict[int, tuple[Any, float]] = field(default_factory=dict)  # telemetry, receive time
    pose_received: float = nan  # receive time of the base's last pose
    base: Any = None  # BaseTelemetry
    gripper: Any = None  # GripperState
    propellant: float = nan  # [kg]
    verdicts: dict[str, str] = field(default_factory=dict)  # by kind of calibration
    #: Heading, measured minus predicted, and its sigma [rad].
    heading_difference: tuple[float, float] = nan, nan
    node_errors: dict[str, str] = field(default_factory=dict)  # by node
    #: Deadlines missed by each node: in all, and since its last report but one, with receive time.
    missed: dict[str, tuple[int, int, float]] = field(default_factory=dict)

    def add_report(self, node: str, error: str, missed: int, now: float) -> None:
        """Store what a node's diagnostics report: an error, if any, and missed deadlines."""
        self.node_errors.pop(node, None)
        if error:
            self.node_errors[node] = error
        before, *_ = self.missed.get(node, (missed,))
        self.missed[node] = missed, max(0, missed - before), now

    def items(self, now: float) -> list[Item]:
        """Return all items of the strip at time `now` [s]; the node errors come last."""
        found = [*self._arm(now), *self._pose(now), *self._battery(), *self._base()]
        found += self._heading()
        found += [
            Item(kind, verdict, VERDICT_STYLES.get(verdict, WARNING))
            for kind, verdict in self.verdicts.items()
        ]
        late = [
            f"{node.lstrip('/')} {new}"
            for node, (_, new, then) in self.missed.items()
            if new and now - then < TELEMETRY_TIMEOUT
        ]
        if late:
            found.append(Item("deadlines missed now", ", ".join(late), WARNING))
        for node, text in self.node_errors.items():
            found.append(Item(node.lstrip("/"), text, ALARM))
        return found

    def _arm(self, now: float) -> Iterable[Item]:
        if not self.links:
            return
        recent = {i: m for i, (m, then) in self.links.items() if now - then < TELEMETRY_TIMEOUT}
        if lost := sorted(self.links.keys() - recent.keys()):
            yield Item("no telemetry", f"link {_join(lost)}", ALARM)
        if stopped := sorted(i for i, m in recent.items() if m.flags & STOPPED):
            yield Item("STOPPED", f"link {_join(stopped)}", ALARM)
        if faulty := sorted(i for i, m in recent.items() if m.faults):
            yield Item("fault", f"link {_join(faulty)}", ALARM)
        armed = sum(m.armed for m in recent.values())
        text = f"{armed} of {len(self.links)} armed" if armed else "disarmed"
        text = text if recent else "unknown"
        yield Item("arm", text)

    def _pose(self, now: float) -> Iterable[Item]:
        if (age := now - self.pose_received) > TELEMETRY_TIMEOUT:
            yield Item("motion capture", f"base not seen for {age:.0f} s", ALARM)

    def _battery(self) -> Iterable[Item]:
        known = {i: 0.1 * m.battery for i, (m, _) in self.links.items() if m.battery}
        if known:
            lowest = min(known, key=lambda i: known[i])
            yield Item("lowest battery", f"{known[lowest]:.1f} V, link {lowest}")

    def _base(self) -> Iterable[Item]:
        if self.base:
            stopped = bool(self.base.flags & STOPPED)
            text = "STOPPED" if stopped else "armed" if self.base.armed else "disarmed"
            volts = f", {0.1 * self.base.battery:.1f} V" if self.base.battery else ""
            yield Item("base", text + volts, ALARM if stopped else NEUTRAL)
        if isfinite(self.propellant):
            yield Item("propellant", f"{1e3 * self.propellant:.0f} g")
        if self.gripper:
            state = "holds" if self.gripper.holds else "closed" if self.gripper.closed else "open"
            yield Item("gripper", state)

    def _heading(self) -> Iterable[Item]:
        difference, sigma = self.heading_difference
        if isfinite(difference):
            is_alarm = isfinite(sigma) and abs(difference) > ALARM_SIGMAS * sigma
            band = f" ± {degrees(sigma):.2f}" if isfinite(sigma) else ""
            beyond = f", beyond {ALARM_SIGMAS:.0f} sigma" if is_alarm else ""
            text = f"{degrees(difference):+.2f}{band} deg{beyond}"
            yield Item("heading, measured minus predicted", text, ALARM if is_alarm else NEUTRAL)


def _join(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
