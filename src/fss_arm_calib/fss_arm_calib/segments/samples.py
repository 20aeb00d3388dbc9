"""What is kept of each stream, by stamp, until nothing asks for it any more: joints, gyro, links.

Stamps are integer nanoseconds; none is taken that is not newer than the last.
"""

from array import array
from bisect import bisect_left, bisect_right
from itertools import pairwise
from math import isfinite
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.poses import SECOND
from fss_arm_calib.segments.streams import Joint


class Samples(Joint):
    """One joint's samples, and its present run of still ones."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.t, self.q, self.qd = array("q"), array("d"), array("d")
        self.start = self.last = -1  # of the run
        self.moved = -1  # the last sample before it
        self.low = self.high = 0.0

    def take(self, still: float) -> bool:
        """Merge the oldest sample that waits; return whether it ended a run."""
        t, q, qd = self.waiting.popleft()
        self.t.append(t)
        self.q.append(q)
        self.qd.append(qd)
        ends = self.start >= 0 and max(self.high, q) - min(self.low, q) > still
        if ends or self.start < 0:
            self.moved = self.last
            self.start, self.low, self.high = t, q, q
        else:
            self.low, self.high = min(self.low, q), max(self.high, q)
        self.last = t
        return ends

    def within(self, begin: int, end: int) -> tuple[np.ndarray, Floats, Floats]:
        """Stamps, readings and rates from `begin` to `end`, both included."""
        a, b = bisect_left(self.t, begin), bisect_right(self.t, end)
        return np.array(self.t[a:b]), np.array(self.q[a:b]), np.array(self.qd[a:b])

    def forget(self, before: int) -> None:
        """Drop all but the last one of what is older."""
        k = max(bisect_left(self.t, before) - 1, 0)
        del self.t[:k], self.q[:k], self.qd[:k]


class Gyro:
    """The base's turn rates by stamp."""

    def __init__(self) -> None:
        self.newest = -1
        self.t, self.rate = array("q"), array("d")

    def append(self, t: int, rate: float) -> None:
        """Take a rate [rad/s], if it is a number."""
        if t > self.newest and isfinite(rate):
            self.newest = t
            self.t.append(t)
            self.rate.append(rate)

    def turn(self, begin: int, end: int, gap: float) -> float | None:
        """Angle turned in an interval [rad]; None if there is a longer gap [ns] in the rates."""
        found = self.angles(begin, end, gap)
        return None if found is None else float(np.diff(np.interp([begin, end], *found))[0])

    def angles(self, begin: int, end: int, gap: float) -> tuple[np.ndarray, Floats] | None:
        """Stamps and angles turned since the first of them [rad]; None: there is a longer gap."""
        a, b = max(bisect_right(self.t, begin) - 1, 0), bisect_left(self.t, end) + 1
        t, rate = np.array(self.t[a:b]), np.array(self.rate[a:b])
        if len(t) < 2 or t[0] > begin or t[-1] < end or np.diff(t).max() > gap:
            return None
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t) / SECOND
        return t, np.concatenate([[0.0], np.cumsum(steps)])

    def forget(self, before: int) -> None:
        """Drop all but the last one of what is older."""
        k = max(bisect_right(self.t, before) - 1, 0)
        del self.t[:k], self.rate[:k]


class Told(NamedTuple):
    """What a link tells of itself, from a moment on."""

    t: int  # [ns]
    armed: bool
    reference: tuple[int, int]  # start of its electronics, and homings since; 0 homings: not told


class Link:
    """A link's telemetry, wherever it changed."""

    def __init__(self) -> None:
        self.newest = -1
        self.told: list[Told] = []

    def append(self, told: Told) -> None:
        """Take what is told, if it is another thing."""
        if told.t > self.newest:
            self.newest = told.t
            if not self.told or self.told[-1][1:] != told[1:]:
                self.told.append(told)

    def within(self, begin: int, end: int) -> list[Told]:
        """What held at the begin of an interval, and what was told until its end."""
        a, b = (bisect_right(self.told, t, key=itemgetter(0)) for t in (begin, end))
        return self.told[max(a - 1, 0) : b]

    def disarmed(self, begin: int, end: int) -> list[tuple[int, int]]:
        """The parts of an interval, both ends included, in which it was not armed."""
        told = self.within(begin, end)
        edges = [*(max(begin, one.t) for one in told), end + 1]
        parts = zip(told, pairwise(edges), strict=True)
        return [(a, b - 1) for one, (a, b) in parts if not one.armed]

    def homed(self, begin: int, end: int) -> bool:
        """Whether it was referenced anew meanwhile, or restarted, the drive perhaps with it."""
        told = self.within(begin, end)
        return len({one.reference for one in told if one.reference[1]}) > 1

    def forget(self, before: int) -> None:
        """Drop what no longer held then."""
        del self.told[: max(bisect_right(self.told, before, key=itemgetter(0)) - 1, 0)]
