"""Recent measurements: their drift before a motion, and their changes during it."""

from collections import deque
from collections.abc import Sequence
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND

MAX_HISTORY = 900 * SECOND  # [ns]
BLOCKS = 8  # number of blocks of rows; errors of block means are independent, those of rows are not


class Drift(NamedTuple):
    """Drift of k values that are otherwise at rest."""

    at: Floats  # (k,) values at the end
    rate: Floats  # (k,) [1/s]
    covariance: Floats  # (k, k) of the rates


class Track:
    """Rows of k values with their stamps; the value at index `angle` is unwrapped."""

    def __init__(self, angle: int | None = None) -> None:
        self.angle = angle
        self._rows: deque[tuple[int, Sequence[float]]] = deque()

    def add(self, t: int, values: Sequence[float]) -> None:
        """Add values at t [ns]; if the stamp goes back, or k changes, delete all earlier rows."""
        if self._rows and (t < self._rows[-1][0] or len(values) != len(self._rows[-1][1])):
            self._rows.clear()
        elif self._rows and t == self._rows[-1][0]:
            self._rows.pop()  # replaced by a better estimate
        if self._rows and self.angle is not None:
            before, values = self._rows[-1][1][self.angle], list(values)
            turn = values[self.angle] - before
            values[self.angle] = before + (turn + np.pi) % (2.0 * np.pi) - np.pi
        self._rows.append((t, values))
        while t - self._rows[0][0] > MAX_HISTORY:
            self._rows.popleft()

    def between(self, begin: int, end: int) -> tuple[Floats, Floats]:
        """Return times since `begin` [s], (m,), and rows, (m, k), from `begin` to `end` [ns]."""
        recent = takewhile(lambda row: row[0] >= begin, reversed(self._rows))
        rows = [row for row in recent if row[0] <= end][::-1]
        return np.array([(t - begin) / SECOND for t, _ in rows]), np.array([v for _, v in rows])

    def drift(self, t: int, window: float) -> Drift | None:
        """Fit a line to the window [s] before t [ns]; return None if there are too few rows."""
        times, rows = self.between(t - round(window * SECOND), t)
        if len(times) < 2 * BLOCKS or np.ptp(times) < 0.5 * window:
            return None
        parts = np.array_split(np.arange(len(times)), BLOCKS)
        x = np.array([times[part].mean() for part in parts]) - window
        y = np.array([rows[part].mean(axis=0) for part in parts])
        rate, at = np.polyfit(x, y, 1)
        off = y - np.outer(x, rate) - at
        return Drift(at, rate, off.T @ off / (BLOCKS - 2) / np.sum((x - x.mean()) ** 2))

    def moved(self, begin: int, end: int) -> tuple[Floats, Floats] | None:
        """Return change and largest deviation of each value, (k,); None: there are too few rows."""
        times, rows = self.between(begin, end)
        span = (end - begin) / SECOND
        if len(times) < 2 or times[0] > 0.2 or times[-1] < span - 0.2:
            return None
        first, last = (np.array([np.interp(t, times, one) for one in rows.T]) for t in (0.0, span))
        return last - first, np.abs(rows - first).max(axis=0)
