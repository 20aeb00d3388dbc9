"""Joints' readings, merged by their stamps, and where the arm rests."""

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
    """One joint's readings and rates, and its present run of still ones."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.waiting: deque[tuple[int, tuple[float, float]]] = deque()  # for the other joints
        self.q, self.qd = array("d"), array("d")
        self.columns += [(self.q, 1), (self.qd, 1)]
        self.run = Run()
        self.stillest = -1  # longest time in which it kept still [ns]; -1: none was heard
        self.merged, self.begun = 0, -1  # readings, and the first one's stamp [ns]

    @property
    def period(self) -> float:
        """Mean time between readings [s]; 0: not known."""
        steps = self.merged - 1
        return (self.newest - self.begun) / SECOND / steps if steps > 0 else 0.0

    def append(self, t: int, q: float, qd: float) -> None:
        """Let a reading [rad] and rate [rad/s] wait; NaN: no rate is known."""
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
        """Stamps, readings and rates from `begin` to `end`, both included."""
        inside = self.inside(begin, end)
        return np.array(self.t[inside]), np.array(self.q[inside]), np.array(self.qd[inside])


class Rest(NamedTuple):
    """All joints still."""

    begin: int  # [ns]
    end: int  # as far as all were heard; before `begin`: it is none
    until: int  # when a joint moved
    moved: int  # a moment just before, at which some joint was moving; -1: none is known
    low: tuple[float, ...]  # least reading of each joint, whatever was forgotten of them [rad]
    high: tuple[float, ...]

    @property
    def q(self) -> tuple[float, ...]:
        """Amid all readings of each joint [rad]."""
        return tuple(0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))

    def near(self, q: Sequence[float], threshold: float) -> bool:
        """Whether the readings of each joint and that of another rest are so near each other."""
        rows = zip(self.low, self.high, q, strict=True)
        return all(max(high, at) - min(low, at) <= threshold for low, high, at in rows)


class Rests:
    """The readings of joints 1 to n in order of time, once every joint has passed them.

    A joint that lags the others by more than `horizon` [ns] is waited for no longer: theirs would
    pile up while a link is silent. The arm rests while the readings of each joint stay within
    `motion_threshold` [rad].
    """

    def __init__(self, n: int, motion_threshold: float, horizon: int) -> None:
        self.joints = [Joint(f"joint_{i}", horizon) for i in range(1, n + 1)]
        self.unknown: set[int] = set()  # numbers heard that the arm does not have
        self.others: set[str] = set()  # names heard that are not joint_<i>
        self.motion_threshold, self.horizon = motion_threshold, horizon
        self.begin, self.end = -1, -1  # of the present rest

    @property
    def newest(self) -> int:
        """Stamp of the newest reading."""
        return max(joint.newest for joint in self.joints)

    def add(self, i: int, t: int, q: float, qd: float = nan) -> Iterator[Rest | None]:
        """Take a reading of joint i; for each that is merged, the rest that it ends, if any."""
        if not 1 <= i <= len(self.joints):
            self.unknown.add(i)
            return
        self.joints[i - 1].append(t, q, qd)
        while joint := self._next():
            yield self._merge(joint)

    def drain(self) -> Iterator[Rest | None]:
        """The same with no more to come."""
        while joint := self._next(closing=True):
            yield self._merge(joint)

    def present(self, until: int = -1) -> Rest:
        """The present rest, as far as all joints confirm it."""
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
        """The joint whose oldest reading is next, if nothing older may come."""
        waiting = [joint for joint in self.joints if joint.waiting]
        if not waiting:
            return None
        oldest = min(waiting, key=lambda joint: joint.waiting[0][0])
        complete = closing or len(waiting) == len(self.joints)
        passed = complete or self.newest - oldest.waiting[0][0] > self.horizon
        return oldest if passed else None
