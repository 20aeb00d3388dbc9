"""Samples of all sensors that finders search, merged by stamp, and the state of their streams."""

from collections.abc import Iterable, Iterator
from math import inf

from fss_arm_calib.segments.alignment import Alignment, Offset
from fss_arm_calib.segments.gyro import Gyro
from fss_arm_calib.segments.joints import Joint, Rests
from fss_arm_calib.segments.poses import BASE, TIP, Poses
from fss_arm_calib.segments.samples import Stream
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import LinkTelemetry
from fss_arm_model.units import SECOND
from fss_arm_ros.dates import describe_clock_error

OPTIONAL_TIMEOUT = 0.5  # timeout of optional streams, as a fraction of the horizon


class Sensors:
    """Samples of n joints, two subjects, the base's gyro and the links' telemetry.

    Segments require the subjects `needed`, the first one being the base. The offset between the
    clocks is searched for up to `search` [s].
    """

    def __init__(
        self, n: int, settings: RestSettings, needed: Iterable[str] = (BASE,), search: float = 0.0
    ) -> None:
        s = self.settings = settings
        self.motion_threshold = s.motion_threshold
        self.horizon, self.settle_time, self.min_duration, self.max_duration = (
            round(time * SECOND)
            for time in (s.horizon, s.settle_time, s.min_duration, s.max_duration)
        )
        self.joint_gap, self.vicon_gap = (round(t * SECOND) for t in (s.joint_gap, s.vicon_gap))
        self.rests = Rests(n, self.motion_threshold, self.horizon)
        self.joints = self.rests.joints
        self.subjects = {name: Poses(name, self.horizon) for name in (BASE, TIP)}
        self.base, self.tip = self.subjects.values()
        self.needed_poses = [self.subjects[name] for name in needed]
        self.gyro = Gyro("gyro", self.horizon)
        self.links = [LinkTelemetry(f"link_{i}", self.horizon) for i in range(1, n + 1)]
        self.alignment = Alignment(search)

    @property
    def newest_stamp(self) -> int:
        """Newest stamp of the needed streams; clocks of optional streams may be wrong [ns]."""
        return max(self.rests.newest, *(poses.newest for poses in self.needed_poses))

    @property
    def poses_received_until(self) -> int:
        """Time up to which the needed subjects are received [ns]."""
        return min(poses.received_until for poses in self.needed_poses)

    @property
    def received_until(self) -> int:
        """Time up to which all streams are received, except those that have timed out [ns]."""
        poses = self.poses_received_until
        timed_out = poses - round(OPTIONAL_TIMEOUT * self.horizon)
        optional = [one for one in (self.gyro, self.tip, *self.links) if one.newest >= 0]
        return min([poses, *(max(one.received_until, timed_out) for one in optional)])

    def have_passed(self, t: int) -> bool:
        """Return True if all streams have passed a time [ns] or have timed out."""
        return t <= self.received_until or t < self.newest_stamp - self.horizon

    def references(self, t: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return starts and homings of all links as known at t [ns]."""
        boots, homings = zip(*(link.reference(t) for link in self.links), strict=True)
        return boots, homings

    def update_offset(self, move: Offset) -> None:
        """Update the offset between the clocks from a move, and correct for it."""
        self.alignment.add_move(move)
        if self.alignment.offset.deviation < inf:
            self.set_offset(self.alignment.offset.value)

    def set_offset(self, offset: float) -> None:
        """Set the offset of the joints' stamps relative to motion capture's [s]."""
        for poses in self.subjects.values():
            poses.lag = round(offset * SECOND)

    def drop_before(self, oldest: int) -> None:
        """Drop samples before a time [ns], and those older than the largest lag of streams."""
        max_age = 2 * self.horizon + self.max_duration
        oldest = max(oldest, self.newest_stamp - max_age)
        for stream in [*self.joints, *self.subjects.values(), self.gyro, *self.links]:
            stream.drop_before(max(oldest, stream.newest - max_age))

    def streams(self) -> Streams:
        """Return the state of the streams."""
        boots, homings = self.references(inf)
        timed = [*self.joints, *self.subjects.values()]
        every: list[Stream] = [*timed, self.gyro, *self.links]
        return Streams(
            silent=tuple(one.name for one in [*self.joints, *self.needed_poses] if one.newest < 0),
            unknown=tuple(f"joint_{i}" for i in sorted(self.rests.unknown_joints)),
            other_names=tuple(sorted(self.rests.other_names)),
            rejected=count_rejected(every),
            set_back={one.name: one.set_back / SECOND for one in timed},
            offset=self.alignment.offset,
            offset_lower_bound=self.alignment.lower_bound,
            frames={one.name: one.frame for one in self.subjects.values() if one.first_stamp >= 0},
            problems=tuple(self._stream_problems()),
            gyro_ratio=self.gyro.ratio,
            boots=boots,
            homings=homings,
        )

    def _stream_problems(self) -> Iterator[str]:
        """Describe problems of the streams that may hide all data."""
        subjects = [one for one in self.needed_poses if one.first_stamp >= 0]
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
        gap = self.settings.joint_gap
        if slow := [name for name, period in periods.items() if period > gap]:
            period = max(periods.values())
            words = f"sampled only every {period:.2g} s: joint_gap ({gap:g} s) is less"
            yield f"{', '.join(slow)} {words}"
        min_rest = self.settle_time + self.min_duration
        known = [one for one in self.joints if one.newest - one.first_stamp > self.horizon // 2]
        moving = [joint.name for joint in known if joint.longest_rest < min_rest]
        if moving:
            least, threshold = min_rest / SECOND, self.settings.motion_threshold
            words = f"never at rest for {least:g} s with a motion_threshold of {threshold:g} rad"
            yield f"{', '.join(moving)} {words}"


def count_rejected(streams: Iterable[Stream]) -> dict[str, int]:
    """Return the numbers of rejected samples, by stream and reason."""
    return {
        f"{one.name} {why}": number
        for one in streams
        for why, number in sorted(one.rejected.items())
        if number
    }
