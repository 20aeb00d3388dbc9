"""Drifts found in streams: the base floats freely while the arm rests.

A rest of at least `min_duration`, after the time to settle, is a drift. A rest longer than
`max_duration` is split into several drifts.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Rest
from fss_arm_calib.segments.poses import FROZEN, average_bins
from fss_arm_calib.segments.samples import SECOND
from fss_arm_calib.segments.settings import DriftFinderSettings

MIN_POSES = 10  # number of averaged poses needed for a drift


@dataclass(frozen=True)
class Drift:
    """Averaged poses of the base while the arm rests."""

    start: int  # time of the first pose [ns]
    end: int
    q: tuple[float, ...]  # (n) joint readings [rad]
    times: tuple[float, ...]  # (m) times of the poses since `start` [s]
    poses: tuple[tuple[float, ...], ...]  # (m) x, y [m], unwrapped heading [rad]
    frames: tuple[int, ...]  # (m) number of frames averaged
    seconds: tuple[float, ...]  # (m) averaging time [s]
    used: bool = True
    reason: str = ""  # why it is not used


class Interval(NamedTuple):
    """Rest, or part of a long rest [ns]."""

    begin: int
    end: int


class DriftFinder(Finder[Interval, Drift]):
    """Finder of drifts in the samples of n joints and the base."""

    settings: DriftFinderSettings

    def __init__(self, n: int, settings: DriftFinderSettings | None = None) -> None:
        super().__init__(n, settings or DriftFinderSettings())
        self._queued_until = -1  # end of the last interval that became a candidate [ns]

    @property
    def current_rest(self) -> Interval:
        """Present rest of the arm, up to the time that all joints confirm."""
        begin = max(self._queued_until, self.rests.begin)
        return Interval(begin, max(begin, self.rests.end))

    def _process_reading(self, ended_rest: Rest | None) -> None:
        begin, end = self.current_rest
        if ended_rest:
            self._queue_candidate(max(self._queued_until, ended_rest.begin), ended_rest.end)
        elif end - begin >= self.max_duration:
            self._queue_candidate(begin, end)

    def _queue_candidate(self, begin: int, end: int) -> None:
        """Queue an interval at rest as a candidate if it is long enough."""
        self._queued_until = max(self._queued_until, end)
        if end - begin >= self.min_duration:
            self._pending.append(Interval(begin, end))

    def _collect(self, closing: bool = False) -> list[Drift]:
        if closing:
            self._queue_candidate(*self.current_rest)
        return super()._collect(closing)

    def _segment(self, candidate: Interval, closing: bool) -> Drift | None:
        """Return the drift in a rest; None if readings of a joint or enough poses are missing."""
        begin, end = candidate.begin + self.settle_time, candidate.end
        readings = [joint.samples_within(begin, end)[1] for joint in self.joints]
        if not all(map(len, readings)):
            return None
        # The pose of a floating base never stays exactly the same: the receiver repeated it.
        self.base.rejected[FROZEN] += self.base.count_frozen(begin, end, begin - 1)
        t, poses = self.base.samples_within(begin, end, begin - 1)
        poses[:, 2] = np.unwrap(poses[:, 2])
        rows = list(average_bins(t, poses, begin, end, self.settings.bin, begin))
        if len(rows) < MIN_POSES:
            return None
        times, means, frames, seconds = zip(*rows, strict=True)
        q = tuple(float(np.mean(one)) for one in readings)
        start = begin + round(times[0] * SECOND)
        return Drift(start, end, q, tuple(at - times[0] for at in times), means, frames, seconds)

    def _oldest_needed(self) -> int:
        return self._pending[0].begin if self._pending else self.current_rest.begin
