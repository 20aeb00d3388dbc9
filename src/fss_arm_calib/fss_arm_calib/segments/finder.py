"""Finder of segments in the streams of all sensors, as one pipeline of five steps.

1. Merge: samples of all joints are merged by their stamps.
2. Candidate: a merged reading, or the present rest, makes a candidate for a segment.
3. Ready: a candidate waits until every stream has passed its end.
4. Align: the offset between the clocks is updated from the samples around it.
5. Observe: the samples of the candidate become a segment, or are rejected.

Subclasses define steps 2, 4 and 5. Each stream arrives in its own order and
rate, interleaved with the others in any way. The result therefore depends on the data alone: it is
the same live, replayed and read from a file, as long as no stream lags another by more than
`horizon`. The timeout of an optional stream that falls silent is half of `horizon`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import nan
from typing import Any, Generic, TypeVar

from fss_arm_calib.segments.joints import Rest
from fss_arm_calib.segments.sensors import Sensors
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.arrays import Floats, Stamps

CLEANUP_INTERVAL = 1000  # samples between two removals of old data


#: A candidate for a segment: observed when all streams have passed its `end` [ns].
C = TypeVar("C", bound=Any)
S = TypeVar("S")  # a segment


class Finder(ABC, Generic[C, S]):
    """Finder of segments in the samples of all sensors.

    Each method that takes samples returns the segments that they complete, in order of time. Stamps
    are integer nanoseconds.
    """

    def __init__(self, sensors: Sensors) -> None:
        self.sensors = sensors
        self.pending: list[C] = []  # candidates that wait for streams to pass them
        self._until_cleaning = CLEANUP_INTERVAL

    @abstractmethod
    def candidates(self, ended_rest: Rest | None) -> Sequence[C]:
        """Return the candidates that a merged reading completes; it ends a rest, or None."""

    @abstractmethod
    def current_candidate(self, closing: bool) -> C | None:
        """Return a candidate in the present rest; called if no other candidate waits."""

    def align(self, candidate: C) -> None:
        """Update the offset between the clocks before a candidate is observed, if it matters."""

    @abstractmethod
    def observe(self, candidate: C, closing: bool) -> S | None:
        """Return the segment of a candidate; None if it is none."""

    @abstractmethod
    def oldest_needed(self, next_candidate: C | None) -> int:
        """Return the time of the oldest sample that is still needed [ns]."""

    def add_reading(self, i: int, t: int, q: float, qd: float = nan) -> list[S]:
        """Add a reading q [rad] and rate qd [rad/s] of joint i, 1 to n; NaN: rate not known."""
        for ended_rest in self.sensors.rests.add(i, t, q, qd):
            self.pending += self.candidates(ended_rest)
        return self._collect_and_clean()

    def add_pose(self, subject: str, t: int, pose: tuple[float, float, float] | None) -> list[S]:
        """Add a pose x [m], y [m], heading [rad] of a subject; None: it was not visible."""
        self.sensors.subjects[subject].append(t, pose)
        return self._collect_and_clean()

    def add_poses(self, subject: str, t: Stamps, poses: Floats) -> list[S]:
        """Add k poses of a subject at once, (k,) and (k, 3); NaN: it was not visible."""
        self.sensors.subjects[subject].extend(t, poses)
        return self._collect_and_clean(len(t))

    def add_rate(self, t: int, rate: float) -> list[S]:
        """Add a turn rate of the base [rad/s]."""
        self.sensors.gyro.append(t, rate)
        return self._collect_and_clean()

    def add_rates(self, t: Stamps, rates: Floats) -> list[S]:
        """Add k turn rates of the base at once, (k,) each."""
        self.sensors.gyro.extend(t, rates)
        return self._collect_and_clean(len(t))

    def add_telemetry(self, i: int, t: int, armed: bool, boot: int, homings: int) -> list[S]:
        """Add the state of link i, 1 to n: armed or not, its start, and the homings since then."""
        if 1 <= i <= len(self.sensors.links):
            self.sensors.links[i - 1].append(t, armed, boot, homings)
        return self._collect_and_clean()

    def close(self) -> list[S]:
        """Return the segments if no samples follow, including the last rest."""
        for ended_rest in self.sensors.rests.drain():
            self.pending += self.candidates(ended_rest)
        return self._collect(closing=True)

    def streams(self) -> Streams:
        """Return the state of the streams."""
        return self.sensors.streams()

    def _collect_and_clean(self, samples: int = 1) -> list[S]:
        found = self._collect()
        self._until_cleaning -= samples
        if self._until_cleaning <= 0:
            self._until_cleaning = CLEANUP_INTERVAL
            next_candidate = self.pending[0] if self.pending else None
            self.sensors.drop_before(self.oldest_needed(next_candidate))
        return found

    def _collect(self, closing: bool = False) -> list[S]:
        """Return the segments of the candidates that are ready, and of the present rest."""
        found = self._observe_ready(closing)
        if not self.pending and (current := self.current_candidate(closing)):
            self.pending.append(current)
            found += self._observe_ready(closing)
        return found

    def _observe_ready(self, closing: bool) -> list[S]:
        found: list[S] = []
        while self.pending and self._is_ready(self.pending[0], closing):
            segment = self.observe(self.pending.pop(0), closing)
            found += [segment] if segment else []
        return found

    def _is_ready(self, candidate: C, closing: bool) -> bool:
        """Return True if all streams have passed a candidate, with the clocks aligned."""
        if not closing and not self.sensors.have_passed(candidate.end):
            return False
        self.align(candidate)
        return closing or self.sensors.have_passed(candidate.end)  # with the new offset
