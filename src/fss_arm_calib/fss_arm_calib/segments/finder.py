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
from fss_arm_calib.segments.joints import Rest, Rests
from fss_arm_calib.segments.poses import BASE, TIP, Poses
from fss_arm_calib.segments.samples import SECOND, Stamps, Stream, span
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import Link

OPTIONAL = 0.5  # timeout of optional streams, as a fraction of the horizon
CLEANING = 1000  # samples between two removals of old data


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
        self.links = [Link(f"link_{i}", self.horizon) for i in range(1, n + 1)]
        self.alignment = Alignment(search)
        self._pending: list[C] = []
        self._until_cleaning = CLEANING

    def joint(self, i: int, t: int, q: float, qd: float = nan) -> list[S]:
        """Add a reading q [rad] and rate qd [rad/s] of joint i, 1 to n; NaN: rate not known."""
        for ended in self.rests.add(i, t, q, qd):
            self._merged(ended)
        return self._fed()

    def pose(self, subject: str, t: int, pose: tuple[float, float, float] | None) -> list[S]:
        """Add a pose x [m], y [m], heading [rad] of a subject; None: it was not visible."""
        self.subjects[subject].append(t, pose)
        return self._fed()

    def poses(self, subject: str, t: Stamps, poses: Floats) -> list[S]:
        """Add k poses of a subject at once, (k,) and (k, 3); NaN: it was not visible."""
        self.subjects[subject].extend(t, poses)
        return self._fed(len(t))

    def rate(self, t: int, rate: float) -> list[S]:
        """Add a turn rate of the base [rad/s]."""
        self.gyro.append(t, rate)
        return self._fed()

    def rates(self, t: Stamps, rates: Floats) -> list[S]:
        """Add k turn rates of the base at once, (k,) each."""
        self.gyro.extend(t, rates)
        return self._fed(len(t))

    def telemetry(self, i: int, t: int, armed: bool, boot: int, homings: int) -> list[S]:
        """Add the state of link i, 1 to n: armed or not, its start, and the homings since then."""
        if 1 <= i <= len(self.links):
            self.links[i - 1].append(t, armed, boot, homings)
        return self._fed()

    def close(self) -> list[S]:
        """Return the segments if no samples follow, including the last rest."""
        for ended in self.rests.drain():
            self._merged(ended)
        return self._collect(closing=True)

    def streams(self) -> Streams:
        """Return the state of the streams."""
        boots, homings = self._references(inf)
        timed = [*self.joints, *self.subjects.values()]
        every: list[Stream] = [*timed, self.gyro, *self.links]
        return Streams(
            silent=tuple(one.name for one in [*self.joints, *self._poses] if one.newest < 0),
            unknown=tuple(f"joint_{i}" for i in sorted(self.rests.unknown)),
            others=tuple(sorted(self.rests.others)),
            rejected={
                f"{one.name} {why}": number
                for one in every
                for why, number in sorted(one.rejected.items())
                if number
            },
            set_back={one.name: one.set_back / SECOND for one in timed},
            offset=self.alignment.offset,
            offset_beyond=self.alignment.beyond,
            frames={one.name: one.frame for one in self.subjects.values() if one.first >= 0},
            doubts=tuple(self._doubts()),
            boots=boots,
            homings=homings,
        )

    def _doubts(self) -> Iterator[str]:
        """Describe problems of the streams that may hide all data."""
        seen = [one for one in self._poses if one.first >= 0]
        heard = [(joint.name, joint.begun, joint.newest) for joint in self.joints if joint.merged]
        heard += [(poses.name, poses.first, poses.newest) for poses in seen[1:]]
        apart: dict[str, list[str]] = {}  # names by distance
        for name, begin, end in heard if seen else ():
            steps = begin - seen[0].first, end - seen[0].newest
            if min(steps) > self.horizon or max(steps) < -self.horizon:
                apart.setdefault(span(round(steps[1] / SECOND)), []).append(name)
        for words, names in apart.items():
            yield f"clock of {', '.join(names)} {words} that of {seen[0].name}"
        slow = {joint.name: joint.period for joint in self.joints}
        late = [name for name, period in slow.items() if period > self.settings.joint_gap]
        if late:
            period, gap = max(slow.values()), self.settings.joint_gap
            yield f"{', '.join(late)} read every {period:.2g} s only: joint_gap is {gap:g} s"
        moving = [
            joint.name
            for joint in self.joints
            if joint.stillest < self._least_rest and joint.newest - joint.begun > self.horizon // 2
        ]
        if moving:
            least = self._least_rest / SECOND
            threshold = f"motion_threshold, {self.settings.motion_threshold:g} rad"
            yield f"{', '.join(moving)} never still for {least:g} s to within {threshold}"

    @property
    def _least_rest(self) -> int:
        """Shortest time that the arm must rest [ns]."""
        return self.settle_time + self.min_duration

    @abstractmethod
    def _merged(self, ended: Rest | None) -> None:
        """Process another merged reading; `ended` is the rest that it ends, if any."""

    @abstractmethod
    def _segment(self, candidate: C, closing: bool) -> S | None:
        """Return the segment of a candidate; None if it is none."""

    @abstractmethod
    def _needed_since(self) -> int:
        """Return the time of the oldest sample that is still needed [ns]."""

    def _fed(self, samples: int = 1) -> list[S]:
        found = self._collect()
        self._until_cleaning -= samples
        if self._until_cleaning <= 0:
            self._forget()
        return found

    def _collect(self, closing: bool = False) -> list[S]:
        """Return the segments that every stream has passed, or whose streams have timed out."""
        found: list[S | None] = []
        while self._pending and (closing or self._decided(self._pending[0])):
            found.append(self._segment(self._pending.pop(0), closing))
        return [segment for segment in found if segment]

    def _decided(self, candidate: C) -> bool:
        """Return True if all streams have passed a candidate or have timed out."""
        return candidate.end <= self._heard or candidate.end < self._newest - self.horizon

    @property
    def _newest(self) -> int:
        """Newest stamp of the needed streams; clocks of optional streams may be wrong."""
        return max(self.rests.newest, *(poses.newest for poses in self._poses))

    @property
    def _seen(self) -> int:
        """Time up to which the needed subjects are received."""
        return min(poses.reached for poses in self._poses)

    @property
    def _heard(self) -> int:
        """Time up to which all streams are received, except those that have timed out."""
        seen = self._seen
        late = seen - round(OPTIONAL * self.horizon)
        others: list[Stream] = [self.gyro, self.tip, *self.links]
        return min([seen, *(max(one.reached, late) for one in others if one.newest >= 0)])

    @property
    def _poses(self) -> list[Poses]:
        return [self.subjects[name] for name in self.needed]

    def _references(self, t: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return starts and homings of all links as known at t."""
        boots, homings = zip(*(link.reference(t) for link in self.links), strict=True)
        return boots, homings

    def _learn(self, move: Offset) -> None:
        """Update the offset between the clocks from a move, and correct for it."""
        self.alignment.learn(move)
        if self.alignment.offset.deviation < inf:
            self._lag(self.alignment.offset.value)

    def _lag(self, offset: float) -> None:
        """Set the offset of the joints' stamps relative to motion capture's [s]."""
        for poses in self.subjects.values():
            poses.lag = round(offset * SECOND)

    def _forget(self) -> None:
        """Drop samples that no segment needs, and those older than the largest lag of streams."""
        self._until_cleaning = CLEANING
        span = 2 * self.horizon + self.max_duration
        oldest = max(self._needed_since(), self._newest - span)
        for stream in [*self.joints, *self.subjects.values(), self.gyro, *self.links]:
            stream.forget(max(oldest, stream.newest - span))
