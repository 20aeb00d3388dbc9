"""State of a link from its telemetry: armed or not, and the reference of its zero."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar

from fss_arm_calib.segments.samples import Stream

UNKNOWN_REFERENCE = (0, 0)


class LinkState(NamedTuple):
    """State of a link from a time on."""

    t: int  # [ns]
    armed: bool
    reference: tuple[int, int]  # start of the electronics, homings since then; 0: not known


class LinkTelemetry(Stream):
    """Telemetry of a link, stored at changes."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.states: list[LinkState] = []

    def append(self, t: int, armed: bool, boot: int, homings: int) -> None:
        """Append the state of a link; 0 homings: the drive has not reported them yet."""
        for stamp, (is_armed, reference) in self.admit(t, (armed, (boot, homings))):
            self.newest = stamp
            unlike = LinkState(stamp, not is_armed, UNKNOWN_REFERENCE)
            last = self.states[-1] if self.states else unlike
            state = LinkState(stamp, is_armed, reference if reference[1] else last.reference)
            if state[1:] != last[1:]:
                self.states.append(state)

    def reference(self, t: float) -> tuple[int, int]:
        """Return start of the electronics and homings known at t [ns], or else the first known."""
        known = [state for state in self.states if state.reference[1]]
        if known:
            return known[max(bisect_right(known, t, key=itemgetter(0)) - 1, 0)].reference
        suspect = self.suspects[0][1][1] if self.suspects else UNKNOWN_REFERENCE
        return suspect if suspect[1] else UNKNOWN_REFERENCE

    def disarmed_intervals(self, begin: int, end: int) -> list[tuple[int, int]]:
        """Return the parts of an interval, both ends included, in which it was not armed."""
        states = self._during(begin, end)
        edges = [*(max(begin, state.t) for state in states), end + 1]
        parts = zip(states, pairwise(edges), strict=True)
        return [(a, b - 1) for state, (a, b) in parts if not state.armed]

    def was_homed(self, begin: int, end: int) -> bool:
        """Return True if in an interval the drive was homed again, or its link restarted."""
        states = self._during(begin, end)
        return len({state.reference for state in states if state.reference[1]}) > 1

    def _during(self, begin: int, end: int) -> list[LinkState]:
        """Return the state at the start of an interval, and the changes until its end."""
        a, b = (bisect_right(self.states, t, key=itemgetter(0)) for t in (begin, end))
        return self.states[max(a - 1, 0) : b]

    def drop_before(self, before: int) -> None:
        """Drop the states that were outdated at a time [ns]."""
        del self.states[: max(bisect_right(self.states, before, key=itemgetter(0)) - 1, 0)]


def rehomed_joints(before: Any, after: Any) -> list[int]:
    """Return the numbers of the joints whose drives were homed, or links restarted, in between."""
    keys = zip(before.boots, before.homings, after.boots, after.homings, strict=False)
    return [i for i, (a, m, b, n) in enumerate(keys, 1) if m and n and (a, m) != (b, n)]


R = TypeVar("R")  # a datum with `boots` and `homings` (n); 0: not known


def keep_since_homing(found: Sequence[R]) -> list[R]:
    """Return the data with the same joint zeros as the last one, so with the same offsets."""
    return [one for one in found if not rehomed_joints(one, found[-1])]
