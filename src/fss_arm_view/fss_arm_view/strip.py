"""Content of the strip above the view: the most important state of each vehicle."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import degrees, isfinite, nan
from typing import Any, NamedTuple

STOPPED = 2  # State.STOPPED of docs/reference/protocol.md, in the flags of links and board
SILENT = 3.0  # telemetry timeout after which a link is shown as silent [s]
SIGMAS = 3.0  # larger heading differences, in standard deviations, are an alarm
PLAIN, GOOD, WARN, ALARM = "", "good", "warn", "alarm"  # styles of an item
TONES = {"pass": GOOD, "fail": ALARM}  # style of a verdict


class Item(NamedTuple):
    """One item of the strip."""

    name: str
    value: str
    tone: str = PLAIN


@dataclass
class Strip:
    """Last messages received of a vehicle; times are of a monotonic clock [s]."""

    links: dict[int, tuple[Any, float]] = field(default_factory=dict)  # telemetry, receive time
    base: Any = None  # BaseTelemetry
    gripper: Any = None  # GripperState
    propellant: float = nan  # [kg]
    verdicts: dict[str, str] = field(default_factory=dict)  # by kind of calibration
    turn: tuple[float, float] = nan, nan  # heading, measured minus predicted, and its sigma [rad]
    troubles: dict[str, str] = field(default_factory=dict)  # by node: the error that it reports

    def items(self, now: float) -> list[Item]:
        """Return all items of the strip at time `now` [s]; the node errors come last."""
        found = [*self._arm(now), *self._battery(), *self._base(), *self._heading()]
        found += [Item(kind, word, TONES.get(word, WARN)) for kind, word in self.verdicts.items()]
        for node, words in self.troubles.items():
            found.append(Item(node.lstrip("/"), words, ALARM))
        return found

    def _arm(self, now: float) -> Iterable[Item]:
        if not self.links:
            return
        heard = {i: m for i, (m, then) in self.links.items() if now - then < SILENT}
        if silent := sorted(self.links.keys() - heard.keys()):
            yield Item("silent", f"link {_listed(silent)}", ALARM)
        if stopped := sorted(i for i, m in heard.items() if m.flags & STOPPED):
            yield Item("STOPPED", f"link {_listed(stopped)}", ALARM)
        if faulty := sorted(i for i, m in heard.items() if m.faults):
            yield Item("fault", f"link {_listed(faulty)}", ALARM)
        armed = sum(m.armed for m in heard.values())
        words = f"{armed} of {len(self.links)} armed" if armed else "disarmed"
        yield Item("arm", words, WARN if armed else PLAIN)

    def _battery(self) -> Iterable[Item]:
        known = {i: 0.1 * m.battery for i, (m, _) in self.links.items() if m.battery}
        if known:
            least = min(known, key=lambda i: known[i])
            yield Item("lowest battery", f"{known[least]:.1f} V, link {least}")

    def _base(self) -> Iterable[Item]:
        if self.base:
            stopped = bool(self.base.flags & STOPPED)
            words = "STOPPED" if stopped else "armed" if self.base.armed else "disarmed"
            tone = ALARM if stopped else WARN if self.base.armed else PLAIN
            volts = f", {0.1 * self.base.battery:.1f} V" if self.base.battery else ""
            yield Item("base", words + volts, tone)
        if isfinite(self.propellant):
            yield Item("propellant", f"{1e3 * self.propellant:.0f} g")
        if self.gripper:
            held = "holds" if self.gripper.holds else "closed" if self.gripper.closed else "open"
            yield Item("gripper", held)

    def _heading(self) -> Iterable[Item]:
        difference, sigma = self.turn
        if isfinite(difference):
            far = isfinite(sigma) and abs(difference) > SIGMAS * sigma
            band = f" ± {degrees(sigma):.2f}" if isfinite(sigma) else ""
            words = f"{degrees(difference):+.2f}{band} deg"
            yield Item("heading, measured less predicted", words, ALARM if far else PLAIN)


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def told(newest: int, silent: float, vehicles: dict[str, list[Item]]) -> str:
    """Return the strips of all vehicles as JSON for the page.

    Args:
        newest: stamp of the newest measurement [ns]; 0: none yet.
        silent: time since the last measurement was received [s].
        vehicles: items of each vehicle, by name; the name of a single vehicle is empty.
    """
    strips = [{"name": name, "items": items} for name, items in vehicles.items()]
    return json.dumps({"newest": str(newest), "silent": round(silent, 1), "vehicles": strips})
