"""Base class of all finders, which receive streams and return segments found in them.

Each stream arrives in its own order and rate, interleaved with the others in any way. Samples are
merged by their stamps, and nothing is decided before every stream has passed the time in question.
The result therefore depends on the data alone: it is the same live, replayed and read from a file,
as long as no stream lags another by more than `horizon`. The timeout of an optional stream that
falls silent is half of `horizon`.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from math import inf, nan
from typing import ClassVar, Generic, Protocol, TypeVar

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.alignment import Alignment, Offset
from fss_arm_calib.segments.gyro import Gyro
from fss_arm_calib.segments.joints import Joint, Rest, Rests
from fss_arm_calib.segments.poses import BASE, TIP, Poses
from fss_arm_calib.segments.samples import SECOND, Stamps, Stream, describe_clock_error
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import LinkTelemetry

OPTIONAL_TIMEOUT = 0.5  # timeout of optional streams, as a fraction of the horizon
CLEANUP_INTERVAL = 1000  # samples between two removals of old data


class Candidate(Protocol):
    """Candidate for a segment."""

    @property
    def end(self) -> int:
        """Time that all streams must have passed before it is decided [ns]."""


C = TypeVar("C", bound=Candidate)
S = TypeVar("S")  # a segment


class Finder(ABC, Generic[C, S]):
    """Finder of segments in the samples of n joints and of the other streams.

    Each method that takes samples returns the segments that they complete, in order of time. Stamps
    are integer nanoseconds.

    Args:
        n: number of joints.
        settings: definition of a rest.
        search: largest offset between the clocks to search for [s].
    """

    needed: ClassVar[tuple[str, ...]] = (BASE,)  # subjects that segments require

    def __init__(self, n: int, settings: RestSettings, search: float = 0.0) -> None:
        s = self.settings = settings
        self.motion_threshold = s.motion_threshold
        self.horizon, self.settle_time, self.min_duration, self.max_duration = (
            round(time * SECOND)
            for time in (s.horizon, s.settle_time, s.min_duration, s.max_duration)
        )
        self.joint_gap, self.vicon_gap = (round(t * SECOND) for t in (s.joint_gap, s.vicon_gap))
        self.rests = Rests(n, self.motion_threshold, self.horizon)
        self.joints = self.rests.joints
        self.subjects = {
            name: Poses(name, self.horizon, s.max_speed, s.max_turn) for name in (BASE, TIP)
        }
        self.base, self.tip = self.subjects.values()
        self.gyro = Gyro("gyro", self.horizon)
        self.links = [LinkTelemetry(f"link_{i}", self.horizon) for i in range(1, n + 1)]
        self.alignment = Alignment(search)
        self._pending: list[C] = []
        self._until_cleaning = CLEANUP_INTERVAL

    def add_reading(self, i: int, t: int, q: float, qd: float = nan) -> list[S]:
        """Add a reading q [rad] and rate qd [rad/s] of joint i, 1 to n; NaN: rate not known."""
        for ended_rest in self.rests.add(i, t, q, qd):
            self._process_reading(ended_rest)
        return self._collect_and_clean()

    def add_pose(self, subject: str, t: int, pose: tuple[float, float, float] | None) -> list[S]:
        """Add a pose x [m], y [m], heading [rad] of a subject; None: it was not visible."""
        self.subjects[subject].append(t, pose)
        return self._collect_and_clean()

    def add_poses(self, subject: str, t: Stamps, poses: Floats) -> list[S]:
        """Add k poses of a subject at once, (k,) and (k, 3); NaN: it was not visible."""
        self.subjects[subject].extend(t, poses)
        return self._collect_and_clean(len(t))

    def add_rate(self, t: int, rate: float) -> list[S]:
        """Add a turn rate of the base [rad/s]."""
        self.gyro.append(t, rate)
        return self._collect_and_clean()

    def add_rates(self, t: Stamps, rates: Floats) -> list[S]:
        """Add k turn rates of the base at once, (k,) each."""
        self.gyro.extend(t, rates)
        return self._collect_and_clean(len(t))

    def add_telemetry(self, i: int, t: int, armed: bool, boot: int, homings: int) -> list[S]:
        """Add the state of link i, 1 to n: armed or not, its start, and the homings since then."""
        if 1 <= i <= len(self.links):
            self.links[i - 1].append(t, armed, boot, homings)
        return self._collect_and_clean()

    def close(self) -> list[S]:
        """Return the segments if no samples follow, including the last rest."""
        for ended_rest in self.rests.drain():
            self._process_reading(ended_rest)
        return self._collect(closing=True)

    def streams(self) -> Streams:
        """Return the state of the streams."""
        boots, homings = self._references(inf)
        timed = [*self.joints, *self.subjects.values()]
        every: list[Stream] = [*timed, self.gyro, *self.links]
        return Streams(
            silent=tuple(one.name for one in [*self.joints, *self._needed_poses] if one.newest < 0),
            unknown=tuple(f"joint_{i}" for i in sorted(self.rests.unknown_joints)),
            other_names=tuple(sorted(self.rests.other_names)),
            rejected={
                f"{one.name} {why}": number
                for one in every
                for why, number in sorted(one.rejected.items())
                if number
            },
            set_back={one.name: one.set_back / SECOND for one in timed},
            offset=self.alignment.offset,
            offset_lower_bound=self.alignment.lower_bound,
            frames={one.name: one.frame for one in self.subjects.values() if one.first_stamp >= 0},
            problems=tuple(self._stream_problems()),
            boots=boots,
            homings=homings,
        )

    def _stream_problems(self) -> Iterator[str]:
        """Describe problems of the streams that may hide all data."""
        subjects = [one for one in self._needed_poses if one.first_stamp >= 0]
        streams: list[Joint | Poses] = [one for one in self.joints if one.reading_count]
        streams += subjects[1:]
        clock_errors: dict[str, list[str]] = {}  # names of streams, by the error of their clock
        for one in streams if subjects else ():
            errors = one.first_stamp - subjects[0].first_stamp, one.newest - subjects[0].newest
            if min(errors) > self.horizon or max(errors) < -self.horizon:
                words = describe_clock_error(round(errors[1] / SECOND))
                clock_errors.setdefault(words, []).append(one.name)
        for words, names in clock_errors.items():
            yield f"clock of {', '.join(names)} is {words} that of {subjects[0].name}"
        periods = {joint.name: joint.period for joint in self.joints}
        slow = [name for name, period in periods.items() if period > self.settings.joint_gap]
        if slow:
            period, gap = max(periods.values()), self.settings.joint_gap
            words = f"sampled only every {period:.2g} s: joint_gap ({gap:g} s) is less"
            yield f"{', '.join(slow)} {words}"
        moving = [
            joint.name
            for joint in self.joints
            if joint.longest_rest < self._min_rest
            and joint.newest - joint.first_stamp > self.horizon // 2
        ]
        if moving:
            least, threshold = self._min_rest / SECOND, self.settings.motion_threshold
            words = f"never at rest for {least:g} s with a motion_threshold of {threshold:g} rad"
            yield f"{', '.join(moving)} {words}"

    @property
    def _min_rest(self) -> int:
        """Shortest time that the arm must rest [ns]."""
        return self.settle_time + self.min_duration

    @abstractmethod
    def _process_reading(self, ended_rest: Rest | None) -> None:
        """Process another merged reading; `ended_rest` is the rest that it ends, if any."""

    @abstractmethod
    def _segment(self, candidate: C, closing: bool) -> S | None:
        """Return the segment of a candidate; None if it is none."""

    @abstractmethod
    def _oldest_needed(self) -> int:
        """Return the time of the oldest sample that is still needed [ns]."""

    def _collect_and_clean(self, samples: int = 1) -> list[S]:
        found = self._collect()
        self._until_cleaning -= samples
        if self._until_cleaning <= 0:
            self._drop_old_samples()
        return found

    def _collect(self, closing: bool = False) -> list[S]:
        """Return the segments that every stream has passed, or whose streams have timed out."""
        found: list[S | None] = []
        while self._pending and (closing or self._is_complete(self._pending[0])):
            found.append(self._segment(self._pending.pop(0), closing))
        return [segment for segment in found if segment]

    def _is_complete(self, candidate: C) -> bool:
        """Return True if all streams have passed a candidate or have timed out."""
        return (
            candidate.end <= self._received_until
            or candidate.end < self._newest_stamp - self.horizon
        )

    @property
    def _newest_stamp(self) -> int:
        """Newest stamp of the needed streams; clocks of optional streams may be wrong."""
        return max(self.rests.newest, *(poses.newest for poses in self._needed_poses))

    @property
    def _poses_received_until(self) -> int:
        """Time up to which the needed subjects are received."""
        return min(poses.received_until for poses in self._needed_poses)

    @property
    def _received_until(self) -> int:
        """Time up to which all streams are received, except those that have timed out."""
        poses = self._poses_received_until
        timed_out = poses - round(OPTIONAL_TIMEOUT * self.horizon)
        optional = [one for one in (self.gyro, self.tip, *self.links) if one.newest >= 0]
        return min([poses, *(max(one.received_until, timed_out) for one in optional)])

    @property
    def _needed_poses(self) -> list[Poses]:
        return [self.subjects[name] for name in self.needed]

    def _references(self, t: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return starts and homings of all links as known at t."""
        boots, homings = zip(*(link.reference(t) for link in self.links), strict=True)
        return boots, homings

    def _update_offset(self, move: Offset) -> None:
        """Update the offset between the clocks from a move, and correct for it."""
        self.alignment.add_move(move)
        if self.alignment.offset.deviation < inf:
            self._set_offset(self.alignment.offset.value)

    def _set_offset(self, offset: float) -> None:
        """Set the offset of the joints' stamps relative to motion capture's [s]."""
        for poses in self.subjects.values():
            poses.lag = round(offset * SECOND)

    def _drop_old_samples(self) -> None:
        """Drop samples that no segment needs, and those older than the largest lag of streams."""
        self._until_cleaning = CLEANUP_INTERVAL
        max_age = 2 * self.horizon + self.max_duration
        oldest = max(self._oldest_needed(), self._newest_stamp - max_age)
        for stream in [*self.joints, *self.subjects.values(), self.gyro, *self.links]:
            stream.drop_before(max(oldest, stream.newest - max_age))
