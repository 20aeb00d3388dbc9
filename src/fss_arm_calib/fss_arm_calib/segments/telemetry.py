"""State of a link from its telemetry: armed or not, and the reference of its zero."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple, Protocol, TypeVar

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
            last = (
                self.states[-1]
                if self.states
                else LinkState(stamp, not is_armed, UNKNOWN_REFERENCE)
            )
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
        """Return True if in an interval the drive was homed again, or the electronics restarted.

        The drive may have restarted with the electronics.
        """
        states = self._during(begin, end)
        return len({state.reference for state in states if state.reference[1]}) > 1

    def _during(self, begin: int, end: int) -> list[LinkState]:
        """Return the state at the start of an interval, and the changes until its end."""
        a, b = (bisect_right(self.states, t, key=itemgetter(0)) for t in (begin, end))
        return self.states[max(a - 1, 0) : b]

    def drop_before(self, before: int) -> None:
        """Drop the states that were outdated at a time [ns]."""
        del self.states[: max(bisect_right(self.states, before, key=itemgetter(0)) - 1, 0)]


class Referenced(Protocol):
    """Datum with the references of the joints' zeros."""

    @property
    def boots(self) -> tuple[int, ...]:
        """Start of each link's electronics (n); 0: not known."""

    @property
    def homings(self) -> tuple[int, ...]:
        """Number of homings of each drive since then (n); 0: not known."""


def rehomed_joints(before: Referenced, after: Referenced) -> list[int]:
    """Return the numbers of the joints whose zeros may have changed between two data.

    Either the drive was homed again, or the link's electronics restarted, perhaps with the drive.
    """
    keys = zip(before.boots, before.homings, after.boots, after.homings, strict=False)
    return [i for i, (a, m, b, n) in enumerate(keys, 1) if m and n and (a, m) != (b, n)]


R = TypeVar("R", bound=Referenced)


def keep_since_homing(found: Sequence[R]) -> list[R]:
    """Return the data with the same joint zeros as the last one, so with the same offsets."""
    return [one for one in found if not rehomed_joints(one, found[-1])]
