"""What all finders have in common: they are fed streams, and give segments of them.

Streams arrive each in its own order and rate, and interleaved at will: samples are merged by their
stamps, and nothing is decided before every stream has passed the moment in question. What is found
is therefore a function of the data alone, the same live, replayed and read from a file, as long as
no stream lags another by more than `horizon`. Streams that need not be there are waited for up to
half of it, if they fall silent.
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

OPTIONAL = 0.5  # of the horizon: how long streams that need not be there are waited for
CLEANING = 1000  # samples from one forgetting to the next


class Candidate(Protocol):
    """What may be a segment."""

    @property
    def end(self) -> int:
        """Up to when all must be heard before it is decided [ns]."""


C = TypeVar("C", bound=Candidate)
S = TypeVar("S")  # a segment


class Finder(ABC, Generic[C, S]):
    """Fed samples of n joints and what else there is, gives the segments that they complete.

    Each feeding method returns the segments found by it, in order of time. Stamps are integer
    nanoseconds.

    Args:
        n: number of joints.
        settings: what counts as a rest.
        search: for an offset between the clocks [s].
    """

    needed: ClassVar[tuple[str, ...]] = (BASE,)  # subjects without which there are no segments

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
        """A reading q [rad] and rate qd [rad/s] of joint i, 1 to n; NaN: no rate is known."""
        for ended in self.rests.add(i, t, q, qd):
            self._merged(ended)
        return self._fed()

    def pose(self, subject: str, t: int, pose: tuple[float, float, float] | None) -> list[S]:
        """A pose x [m], y [m], heading [rad] of a subject; None: it was not visible."""
        self.subjects[subject].append(t, pose)
        return self._fed()

    def poses(self, subject: str, t: Stamps, poses: Floats) -> list[S]:
        """Many poses of a subject at once, (k,) and (k, 3); NaN: it was not visible."""
        self.subjects[subject].extend(t, poses)
        return self._fed(len(t))

    def rate(self, t: int, rate: float) -> list[S]:
        """A turn rate of the base [rad/s]."""
        self.gyro.append(t, rate)
        return self._fed()

    def rates(self, t: Stamps, rates: Floats) -> list[S]:
        """Many turn rates of the base at once, (k,) each."""
        self.gyro.extend(t, rates)
        return self._fed(len(t))

    def telemetry(self, i: int, t: int, armed: bool, boot: int, homings: int) -> list[S]:
        """What link i, 1 to n, reports: whether it is armed, its start, and its homings since."""
        if 1 <= i <= len(self.links):
            self.links[i - 1].append(t, armed, boot, homings)
        return self._fed()

    def close(self) -> list[S]:
        """What can be said with no more samples to come: the last rest counts, too."""
        for ended in self.rests.drain():
            self._merged(ended)
        return self._collect(closing=True)

    def streams(self) -> Streams:
        """What became of the streams so far."""
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
        """What about the streams may hide all data, in words."""
        seen = [one for one in self._poses if one.first >= 0]
        heard = [(joint.name, joint.begun, joint.newest) for joint in self.joints if joint.merged]
        heard += [(poses.name, poses.first, poses.newest) for poses in seen[1:]]
        apart: dict[str, list[str]] = {}  # names by how far
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
        """How long the arm must rest [ns]."""
        return self.settle_time + self.min_duration

    @abstractmethod
    def _merged(self, ended: Rest | None) -> None:
        """Another reading was merged; it may have ended a rest, however short."""

    @abstractmethod
    def _segment(self, candidate: C, closing: bool) -> S | None:
        """What a candidate is; None: nothing."""

    @abstractmethod
    def _needed_since(self) -> int:
        """Since when samples may still be asked for [ns]."""

    def _fed(self, samples: int = 1) -> list[S]:
        found = self._collect()
        self._until_cleaning -= samples
        if self._until_cleaning <= 0:
            self._forget()
        return found

    def _collect(self, closing: bool = False) -> list[S]:
        """What every stream has passed by now, or is waited for no longer."""
        found: list[S | None] = []
        while self._pending and (closing or self._decided(self._pending[0])):
            found.append(self._segment(self._pending.pop(0), closing))
        return [segment for segment in found if segment]

    def _decided(self, candidate: C) -> bool:
        """Whether all has been heard of a candidate, or is waited for no longer."""
        return candidate.end <= self._heard or candidate.end < self._newest - self.horizon

    @property
    def _newest(self) -> int:
        """The newest stamp of what is needed; what is not has no say, its clock may be wrong."""
        return max(self.rests.newest, *(poses.newest for poses in self._poses))

    @property
    def _seen(self) -> int:
        """Up to when the subjects needed have been heard."""
        return min(poses.reached for poses in self._poses)

    @property
    def _heard(self) -> int:
        """Up to when all has been heard that is waited for."""
        seen = self._seen
        late = seen - round(OPTIONAL * self.horizon)
        others: list[Stream] = [self.gyro, self.tip, *self.links]
        return min([seen, *(max(one.reached, late) for one in others if one.newest >= 0)])

    @property
    def _poses(self) -> list[Poses]:
        return [self.subjects[name] for name in self.needed]

    def _references(self, t: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Starts and homings of all links as known at t."""
        boots, homings = zip(*(link.reference(t) for link in self.links), strict=True)
        return boots, homings

    def _learn(self, move: Offset) -> None:
        """Allow for the clocks' offset that a move shows."""
        self.alignment.learn(move)
        if self.alignment.offset.deviation < inf:
            self._lag(self.alignment.offset.value)

    def _lag(self, offset: float) -> None:
        """Joints' stamps are so much more than motion capture's [s]."""
        for poses in self.subjects.values():
            poses.lag = round(offset * SECOND)

    def _forget(self) -> None:
        """Drop what no segment will ask for, and what lies beyond what streams may lag by."""
        self._until_cleaning = CLEANING
        span = 2 * self.horizon + self.max_duration
        oldest = max(self._needed_since(), self._newest - span)
        for stream in [*self.joints, *self.subjects.values(), self.gyro, *self.links]:
            stream.forget(max(oldest, stream.newest - span))
