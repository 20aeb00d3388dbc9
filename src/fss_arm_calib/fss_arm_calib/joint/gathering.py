"""What a live joint estimate is from: the data that nodes of other kinds have found and hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from fss_arm_calib.outcome import Datum
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.rests import Observation
from fss_arm_calib.segments.streams import Streams


@dataclass(frozen=True)
class Gathered:
    """A session as those nodes hold it: data by kind, and how each node weighs its own."""

    kinematic: tuple[Observation, ...] = ()
    dynamic: tuple[Maneuver, ...] = ()
    drift: tuple[Drift, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)  # by kind, as Provenance has them
    set_back: Mapping[str, float] = field(default_factory=dict)  # by kind: of a clock, too far [s]

    @property
    def data(self) -> dict[str, tuple[Datum, ...]]:
        """By kind; none of a node whose settings are not known."""
        return {kind: getattr(self, kind) for kind in self.settings}

    @property
    def start(self) -> int:
        """Of the first datum [ns]."""
        return min((one.start for some in self.data.values() for one in some), default=0)

    @property
    def end(self) -> int:
        """Of the last datum [ns]."""
        return max((one.end for some in self.data.values() for one in some), default=0)

    @property
    def used(self) -> bool:
        """Always: what may not be used its nodes say of each datum."""
        return True

    @property
    def reason(self) -> str:
        """None."""
        return ""


class Gatherer:
    """Told what the nodes of other kinds hold, gives a session whenever that has changed.

    What a node tells takes the place of what it told before: what it has forgotten is gone. Of a
    node that has ended, or of a run before this one, the last is kept.

    Args:
        n: number of joints of the arm that data must be of.
        kinds: names of the nodes.
        kept: by a run before this one.
    """

    def __init__(self, n: int, kinds: Sequence[str], kept: Sequence[Gathered] = ()) -> None:
        self.n, self.kinds = n, kinds
        self.gathered = kept[-1] if kept else Gathered()
        self.rejected: dict[str, int] = {}
        self._joints: dict[str, int] = {}  # that the data of a kind were last of

    def data(self, kind: str, found: Sequence[Any]) -> list[Gathered]:
        """All data of a kind; those of another arm are rejected."""
        others = (joints for joints in map(_joints, found) if joints != self.n)
        self._joints[kind] = next(others, self.n)
        if self._joints[kind] != self.n:
            self.reject(f"{kind} of another arm")
            return []
        before = getattr(self.gathered, kind)
        now: dict[str, Any] = {kind: tuple(found)}
        self.gathered = replace(self.gathered, **now)
        same = [*map(_identity, before)] == [*map(_identity, found)]
        return [] if same or kind not in self.gathered.settings else [self.gathered]

    def result(self, kind: str, settings: str, back: float) -> list[Gathered]:
        """By which settings a node solves, and how far a clock of its ran back, if too far [s]."""
        before = self.gathered
        self.gathered = replace(
            before,
            settings={**before.settings, kind: settings},
            set_back={**before.set_back, kind: back},
        )
        same = (before.settings, before.set_back) == (
            self.gathered.settings, self.gathered.set_back,
        )  # fmt: skip
        return [] if same or not getattr(before, kind) else [self.gathered]

    def reject(self, what: str) -> None:
        """Count a message that cannot be used."""
        self.rejected[what] = self.rejected.get(what, 0) + 1

    def close(self) -> list[Gathered]:
        """None: the nodes tell what they find at once."""
        return []

    def streams(self) -> Streams:
        """Which joints their data are of, if not of the arm's; of whom there are none yet."""
        others = [joints for joints in self._joints.values() if joints != self.n]
        fewest, most = min([self.n, *others]), max([self.n, *others])
        silent = [f"joint_{i}" for i in range(fewest + 1, self.n + 1)]
        return Streams(
            silent=tuple(silent) if any(self.gathered.data.values()) else (*self.kinds, *silent),
            unknown=tuple(f"joint_{i}" for i in range(self.n + 1, most + 1)),
            rejected=dict(self.rejected),
        )


def _joints(one: Any) -> int:
    """How many a datum is of."""
    return len(one.q)


def _identity(one: Datum) -> tuple[int, int, bool, str]:
    """What tells two data of a kind apart."""
    return one.start, one.end, one.used, one.reason
