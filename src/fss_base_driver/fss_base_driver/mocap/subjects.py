"""Which poses of a frame are believed: those that are new, no jump, and not another subject's.

Motion-capture systems repeat the last pose of an occluded subject, and when they mistake markers a
subject jumps, perhaps to where another one is. A pose is believed if the last one of its subject
was, and it could have moved there since. A subject that jumped is believed again when it jumps
back, or has moved on plausibly for a while. One that jumped to where another was, which is there no
more, must jump back, or somebody must say that the names are right.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import acos, dist, isfinite

Pose = tuple[float, float, float, float, float, float, float]
"""x, y, z [m], quaternion x, y, z, w."""

SECOND = 1_000_000_000
MOST = 100  # subjects that are looked after: whoever sends names may send any number of them
NOISE, TURN_NOISE = 0.03, 0.2  # more than an undisturbed pose jumps [m], [rad]


@dataclass(frozen=True)
class Bounds:
    """What is plausible."""

    speed: float  # most of a subject [m/s]
    turn: float  # most of a subject [rad/s]
    settle_time: float  # after a jump, until a subject that moved on plausibly is believed [s]


@dataclass
class Subject:
    """One subject."""

    seen: tuple[int, Pose]  # the last pose, with its stamp [ns]
    believed: tuple[int, Pose]  # the last that was believed
    arrival: int  # of the last pose [ns]
    jumped: int = 0  # arrival of the pose that last did [ns]; 0: it is believed
    place_of: str = ""  # whose place it jumped to
    counts: Counter[str] = field(default_factory=Counter)


class Subjects:
    """Decides frame by frame which poses to believe.

    Stamps say how far a subject may have moved, and may be anybody's. How long ago something was
    is told by times of arrival [ns], of a clock that nobody sets.
    """

    def __init__(self, bounds: Bounds) -> None:
        self.bounds = bounds
        self.subjects: dict[str, Subject] = {}
        self.left_out = 0  # poses of subjects beyond MOST

    def take(self, stamp: int, poses: Mapping[str, Pose], arrival: int) -> dict[str, Pose]:
        """The poses of a frame that are believed."""
        believed, jumpers = {}, []
        for name, pose in poses.items():
            if not is_pose(pose):
                self._count(name, "invalid")
            elif name not in self.subjects:
                if len(self.subjects) < MOST:
                    self.subjects[name] = Subject((stamp, pose), (stamp, pose), arrival)
                    believed[name] = pose
                else:
                    self.left_out += 1
            elif pose == self.subjects[name].seen[1]:
                self._count(name, "unchanged")
            else:
                subject = self.subjects[name]
                subject.arrival = arrival
                jumped = not self._is_near(subject.seen, stamp, pose)
                if self._is_believed(subject, stamp, pose, jumped):
                    believed[name] = pose
                elif jumped:
                    jumpers.append(name)
                subject.seen = stamp, pose
        for name in jumpers:
            self.subjects[name].place_of = self._whose_place(name, stamp, poses)
        for name, pose in believed.items():
            self.subjects[name].believed = stamp, pose
            self._count(name, "believed")
        return believed

    def accept(self) -> None:
        """Believe all subjects where they are now."""
        for subject in self.subjects.values():
            subject.believed, subject.jumped, subject.place_of = subject.seen, 0, ""

    def doubts(self, now: int) -> dict[str, str]:
        """By subject, why it is not believed, in words."""
        return {
            name: f"jumped {(now - s.jumped) / SECOND:.1f} s ago"
            + (f" to where {s.place_of} was: swapped names?" if s.place_of else "")
            for name, s in self.subjects.items()
            if s.jumped
        }

    def silent(self, now: int, timeout: float) -> dict[str, float]:
        """By subject, for how long no new pose came [s], if for longer than the timeout [s]."""
        ages = {name: (now - s.arrival) / SECOND for name, s in self.subjects.items()}
        return {name: age for name, age in ages.items() if age > timeout}

    def _is_believed(self, subject: Subject, stamp: int, pose: Pose, jumped: bool) -> bool:
        if not subject.jumped and not jumped:
            return True
        if jumped and subject.jumped and self._is_near(subject.believed, stamp, pose):
            settled = True
        elif jumped:
            subject.counts["jumped"] += 1
            subject.jumped, settled = subject.arrival, False
        else:
            since = (subject.arrival - subject.jumped) / SECOND
            settled = not subject.place_of and since > self.bounds.settle_time
        if settled:
            subject.jumped, subject.place_of = 0, ""
        return settled

    def _is_near(self, last: tuple[int, Pose], stamp: int, pose: Pose) -> bool:
        """Whether a subject could have come from its last pose to this one."""
        elapsed = abs(stamp - last[0]) / SECOND
        way, angle = dist(last[1][:3], pose[:3]), _angle(last[1][3:], pose[3:])
        return (
            way <= NOISE + self.bounds.speed * elapsed
            and angle <= TURN_NOISE + self.bounds.turn * elapsed
        )

    def _whose_place(self, name: str, stamp: int, poses: Mapping[str, Pose]) -> str:
        """The subject whose place this one may have taken; empty: nobody's."""
        for other, subject in self.subjects.items():
            gone = other not in poses or subject.jumped
            if other != name and gone and self._is_near(subject.believed, stamp, poses[name]):
                return other
        return ""

    def _count(self, name: str, what: str) -> None:
        if name in self.subjects:
            self.subjects[name].counts[what] += 1


def is_pose(pose: Pose) -> bool:
    """Whether these are finite numbers, and a quaternion that turns."""
    return all(map(isfinite, pose)) and 0.25 < sum(x * x for x in pose[3:]) < 4.0


def _angle(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Between the orientations of two quaternions, not necessarily of length 1 [rad]."""
    sizes = (sum(x * x for x in a) * sum(x * x for x in b)) ** 0.5
    return 2.0 * acos(min(abs(sum(x * y for x, y in zip(a, b, strict=True))) / sizes, 1.0))
