"""Drifts out of streams: while the arm rests, the base floats as it will.

As with maneuvers.py, samples are merged by their stamps and nothing is decided before every stream
has passed the moment in question: what is found is a function of the data alone.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.poses import FROZEN, SECOND, Poses
from fss_arm_calib.segments.rests import BASE
from fss_arm_calib.segments.samples import Samples
from fss_arm_calib.segments.settings import DriftFinderSettings
from fss_arm_calib.segments.streams import Merge, Streams

_FEWEST = 10  # averaged poses of a drift
_CLEANING = 1000  # poses between two looks at what may be forgotten


@dataclass(frozen=True)
class Drift:
    """The base's averaged poses while the arm rests."""

    start: int  # of the first pose [ns]
    end: int
    q: tuple[float, ...]  # (n) joint readings [rad]
    times: tuple[float, ...]  # (m) of the poses, from `start` on [s]
    poses: tuple[tuple[float, ...], ...]  # (m) x, y [m], heading [rad], counting turns
    frames: tuple[int, ...]  # (m) averaged
    seconds: tuple[float, ...]  # (m) over which [s]
    used: bool = True
    reason: str = ""  # why it is not used


class DriftFinder:
    """Fed samples of n joints and the base, returns the drifts that they complete."""

    def __init__(self, n: int, settings: DriftFinderSettings | None = None) -> None:
        self.settings = s = settings or DriftFinderSettings()
        self.joints = [Samples(f"joint_{i}") for i in range(1, n + 1)]
        self.base = Poses(BASE, s.max_speed, s.max_turn)
        self._merge = Merge(self.joints, s.horizon)
        self._since = -1  # what was before has been taken [ns]
        self._pending: list[tuple[int, int]] = []  # rests
        self._until_cleaning = _CLEANING

    def joint(self, i: int, t: int, q: float) -> list[Drift]:
        """A reading q [rad] of joint i, 1 to n, at stamp t [ns]."""
        for joint in self._merge.add(i, t, q):
            self._take(joint)
        return self._collect()

    def pose(self, t: int, pose: tuple[float, float, float] | None) -> list[Drift]:
        """A pose x [m], y [m], heading [rad] of the base; None: it was not visible."""
        self.base.append(t, pose)
        self._until_cleaning -= 1
        if self._until_cleaning <= 0:  # the arm may say nothing
            self._until_cleaning = _CLEANING
            span = self.settings.max_duration + self.settings.settle_time + self.settings.horizon
            self.base.forget(self.base.newest - round(span * SECOND))
        return self._collect()

    def poses(self, t: np.ndarray, poses: Floats) -> list[Drift]:
        """Many poses of the base at once, (k,) and (k, 3); NaN: it was not visible."""
        self.base.extend(t, poses)
        return self._collect()

    def close(self) -> list[Drift]:
        """The drift that lasts, too, as far as it is known."""
        for joint in self._merge.rest():
            self._take(joint)
        self._end(*self.resting)
        return self._collect(everything=True)

    @property
    def resting(self) -> tuple[int, int]:
        """Begin and end of the arm's present rest, as far as all joints tell [ns]."""
        if any(joint.start < 0 for joint in self.joints):
            return 0, 0
        begin = max(self._since, *(joint.start for joint in self.joints))
        return begin, max(begin, min(joint.last for joint in self.joints))

    def streams(self) -> Streams:
        """What befell the streams so far."""
        return Streams.of([*self.joints, self.base], self._merge.strange)

    def _take(self, joint: Samples) -> None:
        """The next sample is a joint's."""
        begin, end = self.resting
        moves = joint.take(self.settings.motion_threshold)
        if moves or end - begin >= self.settings.max_duration * SECOND:
            self._end(begin, end)

    def _end(self, begin: int, end: int) -> None:
        """A rest is over, or long enough to count as one."""
        self._since = max(self._since, end)
        if end - begin >= self.settings.min_duration * SECOND:
            self._pending.append((begin, end))
        kept = self._pending[0][0] if self._pending else end
        self.base.forget(kept)
        for joint in self.joints:
            joint.forget(kept)

    def _collect(self, everything: bool = False) -> list[Drift]:
        found = []
        while self._pending and (everything or self._passed(self._pending[0][1])):
            found.append(self._drift(*self._pending.pop(0)))
        return [drift for drift in found if drift and len(drift.times) >= _FEWEST]

    def _passed(self, end: int) -> bool:
        """Whether the base has been heard until then, or is waited for no longer."""
        heard = max(joint.newest for joint in self.joints)
        return self.base.reached >= end or heard - end > self.settings.horizon * SECOND

    def _drift(self, begin: int, end: int) -> Drift | None:
        """The drift of a rest; None if nobody knows how some joint stood."""
        s = self.settings
        begin += round(s.settle_time * SECOND)
        readings = [joint.within(begin, end)[1] for joint in self.joints]
        if not all(map(len, readings)):
            return None
        # What floats never has the very same pose for long: that is a receiver repeating itself.
        self.base.refused[FROZEN] += self.base.frozen(begin, end, begin - 1)
        t, poses = self.base.slice(begin, end, begin - 1)
        inside = (t >= begin) & (t <= end)
        t, poses = t[inside], poses[inside]
        poses[:, 2] = np.unwrap(poses[:, 2])
        edges = np.linspace(begin, end, max(1, round((end - begin) / SECOND / s.bin)) + 1)
        rows = []
        for low, high in pairwise(edges):
            those = (t >= low) & (t < high)
            number = int(np.count_nonzero(those))
            if number >= 2:
                span = float(np.ptp(t[those])) / SECOND * number / (number - 1)
                middle = float(np.mean(t[those] - begin)) / SECOND
                x, y, heading = np.mean(poses[those], axis=0).tolist()
                rows.append((middle, (x, y, heading), number, span))
        first = rows[0][0] if rows else 0.0
        times, means, frames, seconds = zip(*rows, strict=True) if rows else ((), (), (), ())
        q = tuple(float(np.mean(one)) for one in readings)
        start = begin + round(first * SECOND)
        return Drift(start, end, q, tuple(at - first for at in times), means, frames, seconds)
