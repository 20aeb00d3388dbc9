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
from fss_arm_calib.segments.sensors import Sensors
from fss_arm_calib.segments.settings import DriftFinderSettings
from fss_arm_model.units import SECOND

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
    """Finder of drifts, rests of the arm in which the base is seen, in the samples of n joints."""

    def __init__(self, n: int, settings: DriftFinderSettings | None = None) -> None:
        s = settings or DriftFinderSettings()
        super().__init__(Sensors(n, s))
        self.averaging_time = s.bin  # of a pose [s]
        self._queued_until = -1  # end of the last interval that became a candidate [ns]

    @property
    def current_rest(self) -> Interval:
        """Present rest of the arm, up to the time that all joints confirm."""
        begin = max(self._queued_until, self.sensors.rests.begin)
        return Interval(begin, max(begin, self.sensors.rests.end))

    def candidates(self, ended_rest: Rest | None) -> list[Interval]:
        """Return a rest that has ended, or the present one if it is long enough to split."""
        begin, end = self.current_rest
        if ended_rest:
            return self._select(max(self._queued_until, ended_rest.begin), ended_rest.end)
        return self._select(begin, end) if end - begin >= self.sensors.max_duration else []

    def current_candidate(self, closing: bool) -> Interval | None:
        """Return the present rest if no samples follow."""
        return next(iter(self._select(*self.current_rest)), None) if closing else None

    def _select(self, begin: int, end: int) -> list[Interval]:
        """Return an interval at rest as a candidate if it is long enough."""
        self._queued_until = max(self._queued_until, end)
        return [Interval(begin, end)] if end - begin >= self.sensors.min_duration else []

    def observe(self, candidate: Interval, closing: bool) -> Drift | None:
        """Return the drift in a rest; None if readings of a joint or enough poses are missing."""
        base, end = self.sensors.base, candidate.end
        begin = candidate.begin + self.sensors.settle_time
        readings = [joint.samples_within(begin, end)[1] for joint in self.sensors.joints]
        if not all(map(len, readings)):
            return None
        # The pose of a floating base never stays exactly the same: the receiver repeated it.
        base.rejected[FROZEN] += base.count_frozen(begin, end, begin - 1)
        t, poses = base.samples_within(begin, end, begin - 1)
        poses[:, 2] = np.unwrap(poses[:, 2])
        rows = list(average_bins(t, poses, begin, end, self.averaging_time, begin))
        if len(rows) < MIN_POSES:
            return None
        times, means, frames, seconds = zip(*rows, strict=True)
        q = tuple(float(np.mean(one)) for one in readings)
        start = begin + round(times[0] * SECOND)
        return Drift(start, end, q, tuple(at - times[0] for at in times), means, frames, seconds)

    def oldest_needed(self, next_candidate: Interval | None) -> int:
        """Return the start of the next candidate, or else of the present rest [ns]."""
        return (next_candidate or self.current_rest).begin
