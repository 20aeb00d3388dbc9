"""One motion-capture subject's poses by stamp, without those that cannot be true.

Receivers publish zeros or NaN for an occluded subject, repeat its last pose for ever with fresh
stamps, or take one subject's markers for another's. None of these may enter an average.
"""

from array import array
from bisect import bisect_left, bisect_right
from collections import Counter
from math import hypot, isfinite
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_model.planar import wrap

Stamps = npt.NDArray[np.int64]

SECOND = 1_000_000_000  # [ns]

#: What noise of two poses may amount to beside the motion between them.
POSITION_NOISE = 0.1  # [m]
HEADING_NOISE = 0.2  # [rad]

OCCLUDED, JUMP, FROZEN = "occluded", "jump", "frozen"
REPEATED, OUT_OF_ORDER = "repeated", "out of order"


class Hole(NamedTuple):
    """An interval without samples."""

    start: int  # [ns]
    end: int
    who: str
    how: str = "silent"

    def __str__(self) -> str:
        return f"{self.who} {self.how} for {(self.end - self.start) / SECOND:.2f} s"


class Poses:
    """The poses of a subject, in order of their stamps [ns].

    It is asked in time as the joints' stamps tell it, `lag` more than motion capture's.

    Args:
        name: of the subject.
        max_speed: a pose that is farther from the last one than this allows is refused [m/s].
        max_turn: likewise [rad/s].
    """

    def __init__(self, name: str, max_speed: float, max_turn: float) -> None:
        self.name, self.max_speed, self.max_turn = name, max_speed, max_turn
        self.first = self.newest = -1
        self.lag = 0  # [ns]
        self.refused: Counter[str] = Counter()
        self.set_back = 0  # longest step back of the stamps [ns]
        self.t = array("q")
        self.xyh = array("d")
        self.since = array("q")  # when the subject first had the very pose it has at t

    def append(self, t: int, pose: tuple[float, float, float] | None) -> None:
        """Add x [m], y [m], heading [rad] at stamp t; None: it was not visible."""
        if pose is None or not all(map(isfinite, pose)):
            self.refused[OCCLUDED] += 1
        elif t <= self.newest:
            self.refused[REPEATED if t == self.newest else OUT_OF_ORDER] += 1
            self.set_back = max(self.set_back, self.newest - t)
        elif self.t and self._jumps(t, *pose):
            self.refused[JUMP] += 1
        else:
            same = bool(self.t) and tuple(self.xyh[-3:]) == pose
            self.since.append(self.since[-1] if same else t)
            self.t.append(t)
            self.xyh.extend(pose)
            self.newest = t
            if self.first < 0:
                self.first = t

    def extend(self, t: Stamps, poses: Floats) -> None:
        """Add many, (k,) and (k, 3); a row that is not finite was not visible."""
        seen = np.isfinite(poses).all(axis=1)
        if not seen.all():
            self.refused[OCCLUDED] += int(np.sum(~seen))
            t, poses = t[seen], poses[seen]
        if not self.t or not self._plain(t, poses):
            for stamp, pose in zip(t.tolist(), poses.tolist(), strict=True):
                self.append(stamp, tuple(pose))
            return
        before = np.vstack([self.xyh[-3:], poses[:-1]])
        fresh = np.any(poses != before, axis=1)
        since = np.maximum.accumulate(np.where(fresh, t, self.since[-1]))
        self.since.frombytes(since.tobytes())
        self.t.frombytes(t.tobytes())
        self.xyh.frombytes(poses.tobytes())
        self.newest = self.t[-1]

    def _plain(self, t: Stamps, poses: Floats) -> bool:
        """Whether there is nothing to refuse in them."""
        seconds = np.diff(t, prepend=self.newest) / SECOND
        step = np.diff(poses, axis=0, prepend=[self.xyh[-3:]])
        return bool(
            np.all(seconds > 0.0)
            and np.all(
                np.hypot(step[:, 0], step[:, 1]) <= POSITION_NOISE + self.max_speed * seconds
            )
            and np.all(np.abs(wrap(step[:, 2])) <= HEADING_NOISE + self.max_turn * seconds)
        )

    def _jumps(self, t: int, x: float, y: float, heading: float) -> bool:
        seconds = (t - self.newest) / SECOND
        before = self.xyh[-3:]
        turn = abs(float(wrap(heading - before[2])))
        return (
            hypot(x - before[0], y - before[1]) > POSITION_NOISE + self.max_speed * seconds
            or turn > HEADING_NOISE + self.max_turn * seconds
        )

    @property
    def begun(self) -> int:
        """The first stamp."""
        return self.first + self.lag

    @property
    def reached(self) -> int:
        """The newest stamp."""
        return self.newest + self.lag

    def slice(self, begin: int, end: int, moved: int = -1) -> tuple[Stamps, Floats]:
        """Stamps and poses of an interval, with the last one before and the first one after it.

        Without those frozen since before `moved`, a moment at which the subject was moving.
        """
        a = max(bisect_right(self.t, begin - self.lag) - 1, 0)
        b = bisect_left(self.t, end - self.lag) + 1
        fresh = np.array(self.since[a:b]) > moved - self.lag
        poses = np.array(self.xyh[3 * a : 3 * b]).reshape(-1, 3)
        return np.array(self.t[a:b])[fresh] + self.lag, poses[fresh]

    def frozen(self, begin: int, end: int, moved: int) -> int:
        """How many poses of an interval `slice` leaves out."""
        a, b = bisect_left(self.t, begin - self.lag), bisect_right(self.t, end - self.lag)
        return int(np.sum(np.array(self.since[a:b]) <= moved - self.lag))

    def holes(self, begin: int, end: int, gap: float, moved: int = -1) -> list[Hole]:
        """Silences longer than `gap` [ns] that reach into an interval."""
        t = self.slice(begin, end, moved)[0]
        # Poses missing at either end: forgotten, or the stream has ended.
        before = [begin] if not len(t) or t[0] > begin else []
        after = [end] if not len(t) or t[-1] < end else []
        t = np.concatenate([before, t, after]).astype(np.int64)
        late = np.flatnonzero(np.diff(t) > gap)
        found = [(int(t[k]), int(t[k + 1])) for k in late]
        return [
            Hole(a, b, self.name, FROZEN if self.frozen(a, b, moved) else "silent")
            for a, b in found
        ]

    def forget(self, before: float) -> None:
        """Drop all but the last one of what is older."""
        k = max(bisect_right(self.t, before - self.lag) - 1, 0)
        del self.t[:k], self.since[:k], self.xyh[: 3 * k]


def seen_from(
    base: Poses, other: Poses, begin: int, end: int, moved: int = -1
) -> tuple[Stamps, Floats]:
    """Stamps and poses (k, 3) of one subject in the frame of another, within an interval.

    Without those frozen since before `moved`, a moment at which the subjects were moving.
    """
    t, seen = other.slice(begin, end, moved)
    t_base, poses = base.slice(begin, end, moved)
    if not len(t_base):
        return t[:0], seen[:0]
    paired = (t >= max(begin, t_base[0])) & (t <= min(end, t_base[-1]))
    t, seen = t[paired], seen[paired]
    x, y, heading = _interpolated(t - begin, t_base - begin, poses).T
    away = ((seen[:, 0] - x) + 1j * (seen[:, 1] - y)) * np.exp(-1j * heading)
    return t, np.column_stack([away.real, away.imag, wrap(seen[:, 2] - heading)])


def mean_pose(poses: Floats) -> Floats:
    """Of poses (k, 3) that differ by noise; headings are averaged on the circle."""
    heading = np.angle(np.mean(np.exp(1j * poses[:, 2])))
    return np.array([*poses[:, :2].mean(axis=0), heading])


def _interpolated(t: Stamps, stamps: Stamps, poses: Floats) -> Floats:
    """Poses at other times, exactly those given where the stamps are equal."""
    columns = [poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2])]
    return np.column_stack([np.interp(t, stamps, column) for column in columns])
