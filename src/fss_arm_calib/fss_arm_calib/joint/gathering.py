"""Data of a live joint estimate, received from the nodes of the other kinds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.rests import Observation
from fss_arm_calib.segments.streams import Datum, Streams
from fss_arm_model.description import joint_names


@dataclass(frozen=True)
class SessionData:
    """Session of the other nodes: data by kind, and the settings of each node."""

    kinematic: tuple[Observation, ...] = ()
    dynamic: tuple[Maneuver, ...] = ()
    drift: tuple[Drift, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)  # by kind, as Provenance has them
    set_back: Mapping[str, float] = field(default_factory=dict)  # by kind: backward clock jump [s]
    used: bool = True  # always: the nodes mark the single data that are not used
    reason: str = ""

    @property
    def data(self) -> dict[str, tuple[Datum, ...]]:
        """Data by kind, except those of nodes with unknown settings."""
        return {kind: getattr(self, kind) for kind in self.settings}

    @property
    def start(self) -> int:
        """Start of the first datum [ns]."""
        return min((one.start for some in self.data.values() for one in some), default=0)

    @property
    def end(self) -> int:
        """End of the last datum [ns]."""
        return max((one.end for some in self.data.values() for one in some), default=0)


class SessionCollector:
    """Collector of the data of the other nodes; it returns a session whenever they change.

    A message of a node replaces its previous one, so data that the node discarded are discarded
    here, too. The last message of a node that stopped, or of a previous run, is kept. Data of arms
    with another number of joints than n are rejected.
    """

    def __init__(self, n: int, kinds: Sequence[str], kept: Sequence[SessionData] = ()) -> None:
        self.n, self.kinds = n, kinds
        self.gathered = kept[-1] if kept else SessionData()
        self.rejected: dict[str, int] = {}
        self._joints: dict[str, int] = {}  # in the last data of each kind

    def data(self, kind: str, found: Sequence[Any]) -> list[SessionData]:
        """Take all data of a kind; data of another arm are rejected."""
        self._joints[kind] = next((len(one.q) for one in found if len(one.q) != self.n), self.n)
        if self._joints[kind] != self.n:
            self.reject(f"{kind} data of another arm")
            return []
        before = getattr(self.gathered, kind)
        now: dict[str, Any] = {kind: tuple(found)}
        self.gathered = replace(self.gathered, **now)
        same = [*map(_identity, before)] == [*map(_identity, found)]
        return [] if same or kind not in self.gathered.settings else [self.gathered]

    def result(self, kind: str, settings: str, back: float) -> list[SessionData]:
        """Take a node's settings and its backward clock jump, if excessive [s]."""
        before = self.gathered
        known, jumps = {**before.settings, kind: settings}, {**before.set_back, kind: back}
        self.gathered = replace(before, settings=known, set_back=jumps)
        same = (before.settings, before.set_back) == (known, jumps)
        return [] if same or not getattr(before, kind) else [self.gathered]

    def reject(self, what: str) -> None:
        """Count a message that cannot be used."""
        self.rejected[what] = self.rejected.get(what, 0) + 1

    def close(self) -> list[SessionData]:
        """Return nothing: the nodes publish their data immediately."""
        return []

    def streams(self) -> Streams:
        """Report joints that are missing in the data or unknown, and nodes without data."""
        others = [joints for joints in self._joints.values() if joints != self.n]
        fewest, most = min([self.n, *others]), max([self.n, *others])
        silent = joint_names(self.n)[fewest:]
        return Streams(
            silent=tuple(silent) if any(self.gathered.data.values()) else (*self.kinds, *silent),
            unknown=tuple(joint_names(most)[self.n :]),
            rejected=dict(self.rejected),
        )


def _identity(one: Datum) -> tuple[int, int, bool, str]:
    """Return the fields that identify a datum among those of its kind."""
    return one.start, one.end, one.used, one.reason
