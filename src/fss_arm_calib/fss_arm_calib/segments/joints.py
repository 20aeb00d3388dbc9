"""Readings of the joints, merged by their stamps, and the rests of the arm."""

from array import array
from collections import deque
from collections.abc import Iterator, Sequence
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.samples import (
    LARGEST,
    NOT_FINITE,
    OUT_OF_RANGE,
    SECOND,
    Stamps,
    Stream,
)
from fss_arm_model.stillness import Run


class Joint(Stream):
    """Readings and rates of a joint, and its present run of readings at rest."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.waiting: deque[tuple[int, tuple[float, float]]] = deque()  # for other joints
        self.q, self.qd = array("d"), array("d")
        self.columns += [(self.q, 1), (self.qd, 1)]
        self.run = Run()
        self.stillest = -1  # longest time at rest [ns]; -1: no reading yet
        self.merged, self.begun = 0, -1  # number of readings, and stamp of the first [ns]

    @property
    def period(self) -> float:
        """Mean time between readings [s]; 0: not known."""
        steps = self.merged - 1
        return (self.newest - self.begun) / SECOND / steps if steps > 0 else 0.0

    def append(self, t: int, q: float, qd: float) -> None:
        """Queue a reading [rad] and rate [rad/s]; NaN: rate not known."""
        if not abs(q) <= LARGEST:
            self.rejected[OUT_OF_RANGE if isfinite(q) else NOT_FINITE] += 1
            return
        if abs(qd) > LARGEST:
            self.rejected[f"rate {OUT_OF_RANGE}"] += 1
            qd = nan
        for sample in self.admit(t, (q, qd)):
            self.newest = sample[0]
            self.waiting.append(sample)

    def within(self, begin: int, end: int) -> tuple[Stamps, Floats, Floats]:
        """Return stamps, readings and rates from `begin` to `end`, both included."""
        inside = self.inside(begin, end)
        return np.array(self.t[inside]), np.array(self.q[inside]), np.array(self.qd[inside])


class Rest(NamedTuple):
    """Interval in which all joints are at rest."""

    begin: int  # [ns]
    end: int  # up to which all joints confirm it; before `begin`: there is no rest
    until: int  # time at which a joint moved
    moved: int  # last time before the rest at which some joint was moving; -1: not known
    low: tuple[float, ...]  # smallest reading of each joint, including dropped readings [rad]
    high: tuple[float, ...]

    @property
    def q(self) -> tuple[float, ...]:
        """Midpoint of the readings of each joint [rad]."""
        return tuple(0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))

    def near(self, q: Sequence[float], threshold: float) -> bool:
        """Return True if each joint's readings and q are within `threshold` of each other."""
        rows = zip(self.low, self.high, q, strict=True)
        return all(max(high, at) - min(low, at) <= threshold for low, high, at in rows)


class Rests:
    """Merged readings of joints 1 to n in order of time, once every joint has passed them.

    A joint that lags the others by more than `horizon` [ns] times out, so that the queues stay
    finite while a link is silent. The arm rests while the readings of each joint stay within
    `motion_threshold` [rad].
    """

    def __init__(self, n: int, motion_threshold: float, horizon: int) -> None:
        self.joints = [Joint(f"joint_{i}", horizon) for i in range(1, n + 1)]
        self.unknown: set[int] = set()  # numbers received that the arm does not have
        self.others: set[str] = set()  # names received that are not joint_<i>
        self.motion_threshold, self.horizon = motion_threshold, horizon
        self.begin, self.end = -1, -1  # of the present rest

    @property
    def newest(self) -> int:
        """Stamp of the newest reading."""
        return max(joint.newest for joint in self.joints)

    def add(self, i: int, t: int, q: float, qd: float = nan) -> Iterator[Rest | None]:
        """Add a reading of joint i; yield for each merged reading the rest that it ends, if any."""
        if not 1 <= i <= len(self.joints):
            self.unknown.add(i)
            return
        self.joints[i - 1].append(t, q, qd)
        while joint := self._next():
            yield self._merge(joint)

    def drain(self) -> Iterator[Rest | None]:
        """Merge the queued readings if none follow; yield as `add` does."""
        while joint := self._next(closing=True):
            yield self._merge(joint)

    def present(self, until: int = -1) -> Rest:
        """Return the present rest, up to the time that all joints confirm."""
        runs = [joint.run for joint in self.joints]
        low, high = tuple(run.low for run in runs), tuple(run.high for run in runs)
        moved = max(run.moved for run in runs)
        return Rest(self.begin, self.end, max(until, self.end), moved, low, high)

    def _merge(self, joint: Joint) -> Rest | None:
        t, (q, qd) = joint.waiting.popleft()
        moves = joint.run.start >= 0 and not joint.run.holds(q, self.motion_threshold)
        ended = self.present(t) if moves else None
        joint.run.add(t, q, self.motion_threshold)
        joint.stillest = max(joint.stillest, joint.run.last - joint.run.start)
        joint.merged += 1
        joint.begun = joint.begun if joint.begun >= 0 else t
        joint.t.append(t)
        joint.q.append(q)
        joint.qd.append(qd)
        self.begin = max(self.begin, joint.run.start)
        self.end = min(one.run.last for one in self.joints)
        return ended

    def _next(self, closing: bool = False) -> Joint | None:
        """Return the joint with the oldest queued reading, if no older one can arrive."""
        waiting = [joint for joint in self.joints if joint.waiting]
        if not waiting:
            return None
        oldest = min(waiting, key=lambda joint: joint.waiting[0][0])
        complete = closing or len(waiting) == len(self.joints)
        passed = complete or self.newest - oldest.waiting[0][0] > self.horizon
        return oldest if passed else None
