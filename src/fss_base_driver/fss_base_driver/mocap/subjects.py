"""Plausibility of poses: new ones that do not jump and do not belong to another subject.

Motion-capture systems repeat the last pose of an occluded subject. If they confuse markers, a
subject jumps, perhaps to the place of another one. A pose is accepted if the last pose of its
subject was accepted, and if the subject could have moved there since. A subject that jumped is
accepted again when it jumps back, or after a time of plausible motion. If it jumped to the place of
another subject, which has left it, it must jump back, or the operator must confirm the names.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import acos, dist, isfinite

from fss_arm_model.units import SECOND

Pose = tuple[float, float, float, float, float, float, float]
"""x, y, z [m], quaternion x, y, z, w."""

MAX_SUBJECTS = 100  # largest number of subjects; senders may use any number of names
NOISE, TURN_NOISE = 0.03, 0.2  # largest jump of an undisturbed pose [m], [rad]


@dataclass(frozen=True)
class Bounds:
    """Limits of plausible motion."""

    speed: float  # largest speed of a subject [m/s]
    turn: float  # largest turn rate of a subject [rad/s]
    settle_time: float  # time of plausible motion after a jump, before poses are accepted [s]


@dataclass
class Subject:
    """State of one subject."""

    last_pose: tuple[int, Pose]  # the last pose, with its stamp [ns]
    accepted: tuple[int, Pose]  # the last accepted pose
    arrival: int  # arrival of the last pose [ns]
    jumped: int = 0  # arrival of the pose that last jumped [ns]; 0: it is accepted
    place_of: str = ""  # subject to whose place it jumped
    counts: Counter[str] = field(default_factory=Counter)


class Subjects:
    """Filter that decides for each frame which poses to accept.

    The stamps limit how far a subject may have moved; they may come from any clock. Ages are
    measured with times of arrival [ns] in a steady clock.
    """

    def __init__(self, bounds: Bounds) -> None:
        self.bounds = bounds
        self.subjects: dict[str, Subject] = {}
        self.ignored = 0  # poses of subjects beyond MAX_SUBJECTS

    def filter_frame(self, stamp: int, poses: Mapping[str, Pose], arrival: int) -> dict[str, Pose]:
        """Return the accepted poses of a frame."""
        accepted, jumpers = {}, []
        for name, pose in poses.items():
            if not is_pose(pose):
                self._count(name, "invalid")
            elif name not in self.subjects:
                if len(self.subjects) < MAX_SUBJECTS:
                    self.subjects[name] = Subject((stamp, pose), (stamp, pose), arrival)
                    accepted[name] = pose
                else:
                    self.ignored += 1
            elif pose == self.subjects[name].last_pose[1]:
                self._count(name, "unchanged")
            else:
                subject = self.subjects[name]
                subject.arrival = arrival
                jumped = not self._is_near(subject.last_pose, stamp, pose)
                if self._is_accepted(subject, stamp, pose, jumped):
                    accepted[name] = pose
                elif jumped:
                    jumpers.append(name)
                subject.last_pose = stamp, pose
        for name in jumpers:
            self.subjects[name].place_of = self._displaced_subject(name, stamp, poses)
        for name, pose in accepted.items():
            self.subjects[name].accepted = stamp, pose
            self._count(name, "accepted")
        return accepted

    def accept_all(self) -> None:
        """Accept all subjects at their present poses."""
        for subject in self.subjects.values():
            subject.accepted, subject.jumped, subject.place_of = subject.last_pose, 0, ""

    def rejection_reasons(self, now: int) -> dict[str, str]:
        """Return the reason for each subject that is not accepted."""
        return {
            name: f"jumped {(now - s.jumped) / SECOND:.1f} s ago"
            + (f" to where {s.place_of} was: swapped names?" if s.place_of else "")
            for name, s in self.subjects.items()
            if s.jumped
        }

    def stale_subjects(self, now: int, timeout: float) -> dict[str, float]:
        """Return the time since the last new pose [s] of each subject beyond the timeout [s]."""
        ages = {name: (now - s.arrival) / SECOND for name, s in self.subjects.items()}
        return {name: age for name, age in ages.items() if age > timeout}

    def _is_accepted(self, subject: Subject, stamp: int, pose: Pose, jumped: bool) -> bool:
        if not subject.jumped and not jumped:
            return True
        if jumped and subject.jumped and self._is_near(subject.accepted, stamp, pose):
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
        """Return True if a subject could have moved from its last pose to this one."""
        elapsed = abs(stamp - last[0]) / SECOND
        way, angle = dist(last[1][:3], pose[:3]), _angle(last[1][3:], pose[3:])
        return (
            way <= NOISE + self.bounds.speed * elapsed
            and angle <= TURN_NOISE + self.bounds.turn * elapsed
        )

    def _displaced_subject(self, name: str, stamp: int, poses: Mapping[str, Pose]) -> str:
        """Return the subject whose place this one may have taken; empty if there is none."""
        for other, subject in self.subjects.items():
            gone = other not in poses or subject.jumped
            if other != name and gone and self._is_near(subject.accepted, stamp, poses[name]):
                return other
        return ""

    def _count(self, name: str, what: str) -> None:
        if name in self.subjects:
            self.subjects[name].counts[what] += 1


def is_pose(pose: Pose) -> bool:
    """Return True if these are finite numbers with a valid quaternion."""
    return all(map(isfinite, pose)) and 0.25 < sum(x * x for x in pose[3:]) < 4.0


def _angle(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Return the angle between two quaternions, not necessarily of length 1 [rad]."""
    sizes = (sum(x * x for x in a) * sum(x * x for x in b)) ** 0.5
    return 2.0 * acos(min(abs(sum(x * y for x, y in zip(a, b, strict=True))) / sizes, 1.0))
