"""What a link reports of itself: whether it is armed, and its zero."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple, Protocol, TypeVar

from fss_arm_calib.segments.samples import Stream

UNKNOWN = (0, 0)


class State(NamedTuple):
    """What holds from a moment on."""

    t: int  # [ns]
    armed: bool
    reference: tuple[int, int]  # start of the electronics, homings since; no homings: not known


class Link(Stream):
    """A link's telemetry, wherever it changed."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.states: list[State] = []

    def append(self, t: int, armed: bool, boot: int, homings: int) -> None:
        """Take what a link reports; it knows of no homings until its drive does."""
        for stamp, (is_armed, reference) in self.admit(t, (armed, (boot, homings))):
            self.newest = stamp
            last = self.states[-1] if self.states else State(stamp, not is_armed, UNKNOWN)
            state = State(stamp, is_armed, reference if reference[1] else last.reference)
            if state[1:] != last[1:]:
                self.states.append(state)

    def reference(self, t: float) -> tuple[int, int]:
        """Start of the electronics and homings as known at t [ns], or first, if later."""
        known = [state for state in self.states if state.reference[1]]
        if known:
            return known[max(bisect_right(known, t, key=itemgetter(0)) - 1, 0)].reference
        once = self.doubted[0][1][1] if self.doubted else UNKNOWN
        return once if once[1] else UNKNOWN

    def disarmed(self, begin: int, end: int) -> list[tuple[int, int]]:
        """The parts of an interval, both ends included, in which it was not armed."""
        states = self._during(begin, end)
        edges = [*(max(begin, state.t) for state in states), end + 1]
        parts = zip(states, pairwise(edges), strict=True)
        return [(a, b - 1) for state, (a, b) in parts if not state.armed]

    def homed(self, begin: int, end: int) -> bool:
        """Whether it was referenced anew meanwhile, or restarted, the drive perhaps with it."""
        states = self._during(begin, end)
        return len({state.reference for state in states if state.reference[1]}) > 1

    def _during(self, begin: int, end: int) -> list[State]:
        """What held at the begin of an interval, and what changed until its end."""
        a, b = (bisect_right(self.states, t, key=itemgetter(0)) for t in (begin, end))
        return self.states[max(a - 1, 0) : b]

    def forget(self, before: int) -> None:
        """Drop what no longer held then."""
        del self.states[: max(bisect_right(self.states, before, key=itemgetter(0)) - 1, 0)]


class Referenced(Protocol):
    """What holds as long as the joints keep their zeros."""

    @property
    def boots(self) -> tuple[int, ...]:
        """(n) start of each link's electronics; 0: not known."""

    @property
    def homings(self) -> tuple[int, ...]:
        """(n) how often its drive was referenced since; 0: not known."""


def homed(before: Referenced, after: Referenced) -> list[int]:
    """Numbers of the joints whose zeros may have changed in between.

    The drive was referenced anew, or the link's electronics restarted, perhaps the drive with it.
    """
    keys = zip(before.boots, before.homings, after.boots, after.homings, strict=False)
    return [i for i, (a, m, b, n) in enumerate(keys, 1) if m and n and (a, m) != (b, n)]


R = TypeVar("R", bound=Referenced)


def since_homed(found: Sequence[R]) -> list[R]:
    """Those with the same zeros of the joints as the last one: only they have offsets in common."""
    return [one for one in found if not homed(one, found[-1])]
