"""Readings of the joints, merged by their stamps, and the rests of the arm."""

from array import array
from collections import deque
from collections.abc import Iterator, Sequence
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from fss_arm_calib.segments.samples import MAX_VALUE, NOT_FINITE, OUT_OF_RANGE, Stream
from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.description import joint_names
from fss_arm_model.stillness import Run
from fss_arm_model.units import SECOND


class Joint(Stream):
    """Readings and rates of a joint, and its present run of readings at rest."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.queue: deque[tuple[int, tuple[float, float]]] = deque()  # until all joints passed
        self.q, self.qd = array("d"), array("d")
        self.columns += [(self.q, 1), (self.qd, 1)]
        self.run = Run()
        self.longest_rest = -1  # longest time at rest [ns]; -1: no reading yet
        self.reading_count, self.first_stamp = 0, -1  # of merged readings [ns]

    @property
    def period(self) -> float:
        """Mean time between readings [s]; 0: not known."""
        steps = self.reading_count - 1
        return (self.newest - self.first_stamp) / SECOND / steps if steps > 0 else 0.0

    def append(self, t: int, q: float, qd: float) -> None:
        """Queue a reading [rad] and rate [rad/s]; NaN: rate not known."""
        if not abs(q) <= MAX_VALUE:
            self.rejected[OUT_OF_RANGE if isfinite(q) else NOT_FINITE] += 1
            return
        if abs(qd) > MAX_VALUE:
            self.rejected[f"rate {OUT_OF_RANGE}"] += 1
            qd = nan
        for sample in self.admit(t, (q, qd)):
            self.newest = sample[0]
            self.queue.append(sample)

    def samples_within(self, begin: int, end: int) -> tuple[Stamps, Floats, Floats]:
        """Return stamps, readings and rates from `begin` to `end`, both included."""
        inside = self.slice_within(begin, end)
        return np.array(self.t[inside]), np.array(self.q[inside]), np.array(self.qd[inside])


class Rest(NamedTuple):
    """Interval in which all joints are at rest."""

    begin: int  # [ns]
    end: int  # up to which all joints confirm it; before `begin`: there is no rest
    moved_at: int  # time at which a joint moved
    last_motion: int  # last time before the rest at which some joint was moving; -1: not known
    low: tuple[float, ...]  # smallest reading of each joint, including dropped readings [rad]
    high: tuple[float, ...]
    has_ended: bool = True  # False: the arm has not moved yet
    is_new: bool = True  # False: no joint has left its place at the rest before

    @property
    def q(self) -> tuple[float, ...]:
        """Midpoint of the readings of each joint [rad]."""
        return tuple(0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))

    def matches(self, q: Sequence[float], threshold: float) -> bool:
        """Return True if each joint's readings and q are within `threshold` of each other."""
        rows = zip(self.low, self.high, q, strict=True)
        return all(max(high, x) - min(low, x) <= threshold for low, high, x in rows)


class Rests:
    """Merged readings of joints 1 to n in order of time, once every joint has passed them.

    A joint that lags the others by more than `horizon` [ns] times out, so that the queues stay
    finite while a link is silent. The arm rests while the readings of each joint stay within
    `motion_threshold` [rad].
    """

    def __init__(self, n: int, motion_threshold: float, horizon: int) -> None:
        self.joints = [Joint(name, horizon) for name in joint_names(n)]
        self.unknown_joints: set[int] = set()  # numbers received that the arm does not have
        self.other_names: set[str] = set()  # names received that are not joint_<i>
        self.motion_threshold, self.horizon = motion_threshold, horizon
        self.begin, self.end = -1, -1  # of the present rest

    @property
    def newest(self) -> int:
        """Stamp of the newest reading."""
        return max(joint.newest for joint in self.joints)

    def add(self, i: int, t: int, q: float, qd: float = nan) -> Iterator[Rest | None]:
        """Add a reading of joint i; yield for each merged reading the rest that it ends, if any."""
        if not 1 <= i <= len(self.joints):
            self.unknown_joints.add(i)
            return
        self.joints[i - 1].append(t, q, qd)
        while joint := self._next_joint():
            yield self._merge(joint)

    def drain(self) -> Iterator[Rest | None]:
        """Merge the queued readings if none follow; yield as `add` does."""
        while joint := self._next_joint(closing=True):
            yield self._merge(joint)

    def current_rest(self, moved_at: int = -1) -> Rest:
        """Return the current rest, up to the time that all joints confirm."""
        runs = [joint.run for joint in self.joints]
        low, high = tuple(run.low for run in runs), tuple(run.high for run in runs)
        last_motion = max(run.moved for run in runs)
        return Rest(self.begin, self.end, max(moved_at, self.end), last_motion, low, high)

    def _merge(self, joint: Joint) -> Rest | None:
        t, (q, qd) = joint.queue.popleft()
        moves = joint.run.start >= 0 and not joint.run.holds(q, self.motion_threshold)
        ended_rest = self.current_rest(t) if moves else None
        joint.run.add(t, q, self.motion_threshold)
        joint.longest_rest = max(joint.longest_rest, joint.run.last - joint.run.start)
        joint.reading_count += 1
        joint.first_stamp = joint.first_stamp if joint.first_stamp >= 0 else t
        joint.t.append(t)
        joint.q.append(q)
        joint.qd.append(qd)
        self.begin = max(self.begin, joint.run.start)
        self.end = min(one.run.last for one in self.joints)
        return ended_rest

    def _next_joint(self, closing: bool = False) -> Joint | None:
        """Return the joint with the oldest queued reading, if no older one can arrive."""
        queued = [joint for joint in self.joints if joint.queue]
        if not queued:
            return None
        oldest = min(queued, key=lambda joint: joint.queue[0][0])
        complete = closing or len(queued) == len(self.joints)
        final = complete or self.newest - oldest.queue[0][0] > self.horizon
        return oldest if final else None
