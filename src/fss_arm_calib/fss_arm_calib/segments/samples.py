"""Buffers of samples by stamp, with the reasons for rejected samples."""

from array import array
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fss_arm_model.arrays import Stamps
from fss_arm_model.units import SECOND

CONFIRMATION_TIME = SECOND  # time for which samples must follow a suspect one to confirm it [ns]
MAX_VALUE = 1e3  # largest valid value on a test bed [rad, rad/s, m]

NOT_FINITE, OUT_OF_RANGE = "not finite", "out of range"
ZERO_STAMP = "with a stamp of 0"
REPEATED, OUT_OF_ORDER, ISOLATED = "repeated", "out of order", "isolated in time"


class Gap(NamedTuple):
    """Interval without samples."""

    start: int  # [ns]
    end: int
    stream: str
    state: str = "silent"

    def __str__(self) -> str:
        return f"{self.stream} {self.state} for {(self.end - self.start) / SECOND:.2f} s"


class Stream:
    """Samples in order of their stamps [ns].

    A stamp farther than `horizon` [ns] from the stream's last one, or the first stamp, is suspect
    until samples have followed it for CONFIRMATION_TIME: then a clock was set, or a long gap has
    ended. Otherwise only the suspect samples are rejected, as isolated in time.
    """

    def __init__(self, name: str, horizon: int) -> None:
        self.name, self.horizon = name, horizon
        self.newest = -1  # newest stamp [ns]; -1: none received
        self.lag = 0  # time in queries minus time of the stream's own stamps [ns]
        self.rejected: Counter[str] = Counter()
        self.set_back = 0  # longest step back of the stamps [ns]
        self.t = array("q")
        self.columns: list[tuple[array[Any], int]] = [(self.t, 1)]  # arrays, values per stamp
        self.suspects: list[tuple[int, Any]] = []

    def admit(self, t: int, value: Any) -> Sequence[tuple[int, Any]]:
        """Return the samples to accept: this one, this one with confirmed suspect ones, or none."""
        if self.suspects:
            since = t - self.suspects[-1][0]
            if since == 0:
                self.rejected[REPEATED if t else ZERO_STAMP] += 1
                return ()
            if 0 < since <= self.horizon:
                self.suspects.append((t, value))
                confirmed = t - self.suspects[0][0] >= CONFIRMATION_TIME
                return self._confirm_suspects() if confirmed else ()
            self.rejected[ISOLATED] += len(self.suspects)
            self.suspects.clear()
        step = t - self.newest
        if self.newest < 0 or abs(step) > self.horizon:
            self.suspects.append((t, value))
        elif step > 0:
            return ((t, value),)
        else:
            self._reject_late(t)
        return ()

    def _confirm_suspects(self) -> Sequence[tuple[int, Any]]:
        samples, self.suspects = self.suspects, []
        if samples[0][0] > self.newest:
            return samples
        for t, _ in samples:
            self._reject_late(t)
        return ()

    def _reject_late(self, t: int) -> None:
        self.rejected[REPEATED if t == self.newest else OUT_OF_ORDER] += 1
        self.set_back = max(self.set_back, self.newest - t)

    def in_order(self, t: Stamps) -> bool:
        """Return True if all samples with these stamps are to be accepted."""
        if self.newest < 0 or self.suspects:
            return False
        steps = np.diff(t, prepend=self.newest)
        return bool(np.all((steps > 0) & (steps <= self.horizon)))

    @property
    def received_until(self) -> int:
        """Newest stamp, in the time of queries [ns]."""
        return self.newest + self.lag

    def slice_around(self, begin: int, end: int) -> slice:
        """Return the slice of an interval, with the last sample before and the first after it."""
        before = max(bisect_right(self.t, begin - self.lag) - 1, 0)
        return slice(before, bisect_left(self.t, end - self.lag) + 1)

    def slice_within(self, begin: int, end: int) -> slice:
        """Return the slice of the samples in an interval, both ends included."""
        return slice(bisect_left(self.t, begin - self.lag), bisect_right(self.t, end - self.lag))

    def gaps(self, begin: int, end: int, max_gap: int) -> list[Gap]:
        """Return the gaps longer than `max_gap` [ns] that overlap an interval."""
        stamps = np.array(self.t[self.slice_around(begin, end)]) + self.lag
        return [Gap(a, b, self.name) for a, b in find_silences(stamps, begin, end, max_gap)]

    def drop_before(self, before: int) -> None:
        """Drop all samples before a time [ns] except the last one of them."""
        k = self.slice_around(before, before).start
        for column, width in self.columns:
            del column[: k * width]


def find_silences(t: Stamps, begin: int, end: int, max_gap: int) -> list[tuple[int, int]]:
    """Return steps longer than `max_gap` between stamps in and around an interval [ns].

    If no sample precedes or follows the interval, its start or end takes the place of a stamp.
    """
    # Samples missing at the start were dropped; at the end the stream has stopped.
    before = [begin] if not len(t) or t[0] > begin else []
    after = [end] if not len(t) or t[-1] < end else []
    t = np.concatenate([before, t, after]).astype(np.int64)
    return [(int(t[k]), int(t[k + 1])) for k in np.flatnonzero(np.diff(t) > max_gap)]


def parts_outside(begin: int, end: int, gaps: Sequence[Gap]) -> list[tuple[int, int]]:
    """Return the parts of an interval that are outside all gaps."""
    edges = [begin]
    for gap in sorted(gaps):
        edges += [max(edges[-1], gap.start), max(edges[-1], gap.end)]
    edges.append(max(edges[-1], end))
    return [(a, b) for a, b in list(pairwise(edges))[::2] if b > a]
