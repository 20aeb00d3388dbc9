"""The base's measured poses of the last while: its drift before a motion, its motion in it."""

from collections import deque
from itertools import takewhile

import numpy as np

from fss_arm_model.kernels import Floats

SECOND = 1_000_000_000
KEPT = 900 * SECOND  # [ns]
FEW = 10  # poses say nothing of a drift


class BaseTrack:
    """Poses by their stamps, the heading unwrapped."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, float, float, float]] = deque()

    def add(self, t: int, pose: tuple[float, float, float]) -> None:
        """Keep a pose [m, m, rad] of t [ns]; where stamps go back, forget the others."""
        if self._poses and t < self._poses[-1][0]:
            self._poses.clear()
        elif self._poses and t == self._poses[-1][0]:
            self._poses.pop()  # an estimate that knows more
        before = self._poses[-1][3] if self._poses else pose[2]
        turned = before + (pose[2] - before + np.pi) % (2.0 * np.pi) - np.pi
        self._poses.append((t, *pose[:2], turned))
        while t - self._poses[0][0] > KEPT:
            self._poses.popleft()

    def between(self, begin: int, end: int) -> tuple[Floats, Floats]:
        """Times since `begin` [s], (k,), and poses, (k, 3), of what was seen from then to `end`."""
        recent = takewhile(lambda row: row[0] >= begin, reversed(self._poses))
        rows = [row for row in recent if row[0] <= end][::-1]
        times = np.array([(row[0] - begin) / SECOND for row in rows])
        return times, np.array([row[1:] for row in rows]).reshape(-1, 3)

    def drift(self, t: int, window: float) -> tuple[Floats, Floats] | None:
        """Pose and twist at t [ns] by a line through the window [s] before; None: too few poses."""
        times, poses = self.between(t - round(window * SECOND), t)
        if len(times) < FEW or np.ptp(times) < 0.5 * window:
            return None
        slope, at = np.polyfit(times - window, poses, 1)
        return at, slope

    def moved(self, begin: int, end: int) -> tuple[Floats, float]:
        """The change of the pose, (3,), and the largest turn on the way; NaN: it was not seen."""
        times, poses = self.between(begin, end)
        span = (end - begin) / SECOND
        if len(times) < 2 or times[0] > 0.2 or times[-1] < span - 0.2:
            return np.full(3, np.nan), np.nan
        ends = [np.array([np.interp(t, times, column) for column in poses.T]) for t in (0.0, span)]
        return ends[1] - ends[0], float(np.abs(poses[:, 2] - ends[0][2]).max())
