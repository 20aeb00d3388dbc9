"""Poses of a motion-capture subject by stamp, without impossible ones.

Receivers publish zeros or NaN for an occluded subject, repeat its last pose indefinitely with new
stamps, or confuse the markers of two subjects. None of these poses may enter an average.
"""

from array import array
from collections.abc import Iterator
from itertools import pairwise
from math import hypot, isfinite
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.segments.samples import (
    MAX_VALUE,
    OUT_OF_RANGE,
    Gap,
    Stream,
    find_silences,
)
from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.planar import wrap
from fss_arm_model.units import SECOND

BASE, TIP = "fss", "end_effector"  # the two subjects, as the motion capture system names them

#: Largest difference of two poses caused by noise, in addition to the motion between them.
POSITION_NOISE = 0.1  # [m]
HEADING_NOISE = 0.2  # [rad]

#: Fastest motion of a subject; poses that imply a faster one are rejected.
MAX_SPEED = 5.0  # [m/s]
MAX_TURN_RATE = 10.0  # [rad/s]

OCCLUDED, JUMP, FROZEN = "occluded", "jump", "frozen"


class Poses(Stream):
    """Poses of a subject.

    Methods take and return times of the joints' clock, `lag` later than motion capture's. A pose
    that has not changed since before `last_motion`, a time at which the subject was moving, is
    frozen.
    """

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.first_stamp = -1  # [ns]
        self.frame = ""  # frame id of the poses
        self.xyh = array("d")
        self.unchanged_since = array("q")  # time since which the pose at t has not changed
        self.columns += [(self.xyh, 3), (self.unchanged_since, 1)]

    def append(self, t: int, pose: tuple[float, float, float] | None) -> None:
        """Add x [m], y [m], heading [rad] at stamp t; None: it was not visible."""
        if pose is None or not all(map(isfinite, pose)):
            self.rejected[OCCLUDED] += 1
        elif max(map(abs, pose)) > MAX_VALUE:
            self.rejected[OUT_OF_RANGE] += 1
        else:
            for stamp, admitted in self.admit(t, pose):
                self._store(stamp, admitted)

    def _store(self, t: int, pose: tuple[float, float, float]) -> None:
        if self.t and self._is_jump(t, *pose):
            self.rejected[JUMP] += 1
            return
        same = bool(self.t) and tuple(self.xyh[-3:]) == pose
        self.unchanged_since.append(self.unchanged_since[-1] if same else t)
        self.t.append(t)
        self.xyh.extend(pose)
        self.newest = t
        if self.first_stamp < 0:
            self.first_stamp = t

    def extend(self, t: Stamps, poses: Floats) -> None:
        """Add k poses, (k,) and (k, 3); in rows that are not finite the subject was not visible."""
        visible = np.isfinite(poses).all(axis=1)
        if not visible.all():
            self.rejected[OCCLUDED] += int(np.sum(~visible))
            t, poses = t[visible], poses[visible]
        if not self._all_plausible(t, poses):
            for stamp, pose in zip(t.tolist(), poses.tolist(), strict=True):
                self.append(stamp, tuple(pose))
            return
        before = np.vstack([self.xyh[-3:], poses[:-1]])
        fresh = np.any(poses != before, axis=1)
        since = np.maximum.accumulate(np.where(fresh, t, self.unchanged_since[-1]))
        self.unchanged_since.frombytes(since.tobytes())
        self.t.frombytes(t.tobytes())
        self.xyh.frombytes(poses.tobytes())
        self.newest = self.t[-1]

    def _all_plausible(self, t: Stamps, poses: Floats) -> bool:
        if not self.in_order(t) or np.any(np.abs(poses) > MAX_VALUE):
            return False
        seconds = np.diff(t, prepend=self.newest) / SECOND
        step = np.diff(poses, axis=0, prepend=[self.xyh[-3:]])
        way, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(wrap(step[:, 2]))
        return bool(np.all(_is_possible(way, turn, seconds)))

    def _is_jump(self, t: int, x: float, y: float, heading: float) -> bool:
        before = self.xyh[-3:]
        way, turn = hypot(x - before[0], y - before[1]), abs(float(wrap(heading - before[2])))
        return not _is_possible(way, turn, (t - self.newest) / SECOND)

    def samples_within(self, begin: int, end: int, last_motion: int = -1) -> tuple[Stamps, Floats]:
        """Return stamps and poses (k, 3) in an interval, without frozen ones."""
        return self._without_frozen(self.slice_within(begin, end), last_motion)

    def samples_around(self, begin: int, end: int, last_motion: int = -1) -> tuple[Stamps, Floats]:
        """Return as `samples_within`, plus the last pose before it and the first after it."""
        return self._without_frozen(self.slice_around(begin, end), last_motion)

    def _without_frozen(self, part: slice, last_motion: int) -> tuple[Stamps, Floats]:
        fresh = np.array(self.unchanged_since[part]) > last_motion - self.lag
        poses = np.array(self.xyh[3 * part.start : 3 * part.stop]).reshape(-1, 3)
        return np.array(self.t[part])[fresh] + self.lag, poses[fresh]

    def count_frozen(self, begin: int, end: int, last_motion: int) -> int:
        """Return the number of frozen poses in an interval."""
        since = np.array(self.unchanged_since[self.slice_within(begin, end)])
        return int(np.sum(since <= last_motion - self.lag))

    def gaps(self, begin: int, end: int, max_gap: int, last_motion: int = -1) -> list[Gap]:
        """Return the gaps longer than `max_gap` [ns] that overlap an interval."""
        stamps = self.samples_around(begin, end, last_motion)[0]
        return [
            Gap(a, b, self.name, FROZEN if self.count_frozen(a, b, last_motion) else "silent")
            for a, b in find_silences(stamps, begin, end, max_gap)
        ]


def _is_possible(way: Any, turn: Any, seconds: Any) -> Any:
    """Return True where a subject can move by `way` [m] and `turn` [rad] in a time [s]."""
    far, turned = POSITION_NOISE + MAX_SPEED * seconds, HEADING_NOISE + MAX_TURN_RATE * seconds
    return (way <= far) & (turn <= turned)


def relative_poses(
    base: Poses, other: Poses, begin: int, end: int, last_motion: int = -1
) -> tuple[Stamps, Floats]:
    """Return stamps and poses (k, 3) of a subject in the frame of another, without frozen ones."""
    t, others = other.samples_around(begin, end, last_motion)
    t_base, poses = base.samples_around(begin, end, last_motion)
    if not len(t_base):
        return t[:0], others[:0]
    paired = (t >= max(begin, t_base[0])) & (t <= min(end, t_base[-1]))
    t, others = t[paired], others[paired]
    columns = poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2])
    x, y, heading = (np.interp(t - begin, t_base - begin, column) for column in columns)
    relative = ((others[:, 0] - x) + 1j * (others[:, 1] - y)) * np.exp(-1j * heading)
    return t, np.column_stack([relative.real, relative.imag, wrap(others[:, 2] - heading)])


def near_median(poses: Floats) -> npt.NDArray[np.bool_]:
    """Return a mask of the poses (k, 3) near the median: at rest the end effector does not move."""
    x, y = (poses[:, :2] - np.median(poses[:, :2], axis=0)).T
    mean = np.angle(np.median(np.cos(poses[:, 2])) + 1j * np.median(np.sin(poses[:, 2])))
    turn = np.abs(wrap(poses[:, 2] - mean))
    return np.asarray((np.hypot(x, y) <= POSITION_NOISE) & (turn <= HEADING_NOISE))


class Bin(NamedTuple):
    """Averaged poses of a drifting subject."""

    time: float  # [s]
    pose: tuple[float, float, float]  # x, y [m], unwrapped heading [rad]
    frames: int  # number of frames averaged
    seconds: float  # averaging time [s]


def average_bins(
    t: Stamps, poses: Floats, begin: int, end: int, width: float, origin: int
) -> Iterator[Bin]:
    """Yield averages of poses (k, 3) over about `width` [s], timed from `origin` [ns]."""
    edges = np.linspace(begin, end, max(1, round((end - begin) / SECOND / width)) + 1)
    for low, high in pairwise(edges):
        inside = (t >= low) & (t < high)
        number = int(np.count_nonzero(inside))
        if number >= 2:
            seconds = float(np.ptp(t[inside])) / SECOND * number / (number - 1)
            x, y, heading = np.mean(poses[inside], axis=0).tolist()
            yield Bin(float(np.mean(t[inside] - origin)) / SECOND, (x, y, heading), number, seconds)


def count_independent(frames: npt.ArrayLike, seconds: npt.ArrayLike, rate: float) -> Floats:
    """Return the number of independent poses in averages (m,), for a rate of such poses [1/s]."""
    return np.minimum(frames, np.maximum(1.0, rate * np.asarray(seconds)))
