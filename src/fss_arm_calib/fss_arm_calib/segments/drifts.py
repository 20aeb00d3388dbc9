"""Drifts out of streams: while the arm rests, the base floats as it will.

A rest of at least `min_duration`, less the time to settle, is a drift; a longer one than
`max_duration` is taken as several.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Rest
from fss_arm_calib.segments.poses import FROZEN, bins
from fss_arm_calib.segments.samples import SECOND
from fss_arm_calib.segments.settings import DriftFinderSettings

FEWEST = 10  # averaged poses of a drift


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


class Interval(NamedTuple):
    """A rest, or a part of a long one [ns]."""

    begin: int
    end: int


class DriftFinder(Finder[Interval, Drift]):
    """Fed samples of n joints and the base, gives the drifts that they complete."""

    settings: DriftFinderSettings

    def __init__(self, n: int, settings: DriftFinderSettings | None = None) -> None:
        super().__init__(n, settings or DriftFinderSettings())
        self._since = -1  # what was before has been taken [ns]

    @property
    def resting(self) -> Interval:
        """The arm's present rest, as far as all joints have been heard."""
        begin = max(self._since, self.rests.begin)
        return Interval(begin, max(begin, self.rests.end))

    def _merged(self, ended: Rest | None) -> None:
        begin, end = self.resting
        if ended:
            self._propose(max(self._since, ended.begin), ended.end)
        elif end - begin >= self.max_duration:
            self._propose(begin, end)

    def _propose(self, begin: int, end: int) -> None:
        """A rest is over, or long enough to count as one."""
        self._since = max(self._since, end)
        if end - begin >= self.min_duration:
            self._pending.append(Interval(begin, end))

    def _collect(self, closing: bool = False) -> list[Drift]:
        if closing:
            self._propose(*self.resting)
        return super()._collect(closing)

    def _segment(self, candidate: Interval, closing: bool) -> Drift | None:
        """The drift of a rest; None if nobody knows how some joint stood, or saw the base."""
        begin, end = candidate.begin + self.settle_time, candidate.end
        readings = [joint.within(begin, end)[1] for joint in self.joints]
        if not all(map(len, readings)):
            return None
        # What floats never has the very same pose for long: that is a receiver repeating itself.
        self.base.rejected[FROZEN] += self.base.frozen(begin, end, begin - 1)
        t, poses = self.base.within(begin, end, begin - 1)
        poses[:, 2] = np.unwrap(poses[:, 2])
        rows = list(bins(t, poses, begin, end, self.settings.bin, begin))
        if len(rows) < FEWEST:
            return None
        times, means, frames, seconds = zip(*rows, strict=True)
        q = tuple(float(np.mean(one)) for one in readings)
        start = begin + round(times[0] * SECOND)
        return Drift(start, end, q, tuple(at - times[0] for at in times), means, frames, seconds)

    def _needed_since(self) -> int:
        return self._pending[0].begin if self._pending else self.resting.begin
