"""Reference of the base: state at one time, and path over time.

Between two knots each coordinate of a path is the polynomial of least degree that has the known
values at both: poses (linear), also twists (cubic), also accelerations (quintic).
"""

from dataclasses import dataclass
from functools import cache, cached_property
from math import factorial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.planar import wrap

SEGMENT_STEPS = 8  # samples per segment between two knots when a whole path is checked


class Body(NamedTuple):
    """State of base or target, in the world."""

    pose: Floats  # (3,) x, y [m], heading [rad]
    twist: Floats  # (3,) [m/s, m/s, rad/s]

    def extrapolate(self, dt: float) -> "Body":
        """Return the state after dt [s] at constant twist."""
        return Body(self.pose + dt * self.twist, self.twist)


@dataclass(frozen=True)
class Reference:
    """Desired pose, twist and acceleration of the base in the world, (3,) each."""

    pose: Floats
    twist: Floats
    acceleration: Floats

    @staticmethod
    def at_rest(pose: npt.ArrayLike) -> "Reference":
        """Return the reference that holds a pose."""
        return Reference(np.array(pose, dtype=float), np.zeros(3), np.zeros(3))


@dataclass(frozen=True)
class Path:
    """Path of the base through knots; at rest before the first and after the last.

    Raises:
        ValueError: there is no knot, times do not increase, or a number is not finite.
    """

    times: Floats  # (k,) increasing [s]
    knots: Floats  # (k, d, 3) the first d of pose, twist and acceleration at each, in the world

    def __post_init__(self) -> None:
        if not len(self.times):
            raise ValueError("the path has no points")
        if not (np.isfinite(self.times).all() and np.isfinite(self.knots).all()):
            raise ValueError("the path has a number that is not finite")
        if (unordered := np.flatnonzero(np.diff(self.times) <= 0.0)).size:
            k = int(unordered[0])
            raise ValueError(
                f"time of point {k + 1} is {self.times[k + 1]:g} s, expected more than "
                f"{self.times[k]:g} s"
            )

    @staticmethod
    def between(initial: Reference, goal: npt.ArrayLike, start: float, duration: float) -> "Path":
        """Return the path from a state at the time `start` [s] to a pose at rest."""
        first = [initial.pose, initial.twist, initial.acceleration]
        last = [np.asarray(goal), np.zeros(3), np.zeros(3)]
        return Path(np.array([start, start + duration]), np.array([first, last]))

    @property
    def end_time(self) -> float:
        """Time of the last knot [s]."""
        return float(self.times[-1])

    def at(self, t: float) -> Reference:
        """Return the reference at a time [s]."""
        return Reference(*self.states(np.array([t]))[0])

    def states(self, t: Floats) -> Floats:
        """Return pose, twist and acceleration at times (m,) [s], (m, 3, 3)."""
        states = np.zeros((len(t), 3, 3))
        states[:, 0] = np.where(t[:, None] < self.times[0], self.knots[0, 0], self.knots[-1, 0])
        inside = (self.times[0] <= t) & (t < self.times[-1])
        k = np.searchsorted(self.times, t[inside], side="right") - 1
        h, c = (self.times[k + 1] - self.times[k])[:, None], self._coefficients[k]
        size = c.shape[1]
        s = ((t[inside] - self.times[k])[:, None] / h) ** _EXPONENTS[:size]
        first, second = _EXPONENTS[1:size] * s[:, :-1], _SECOND_FACTORS[: size - 2] * s[:, :-2]
        for d, part in enumerate((s, first, second)):
            states[inside, d] = np.einsum("mj,mji->mi", part, c[:, d:]) / h**d
        return states

    @cached_property
    def _coefficients(self) -> Floats:
        """Coefficients of the polynomials in s from 0 to 1, (k - 1, 2 d, 3)."""
        steps, depth = np.diff(self.times), self.knots.shape[1]
        scale = steps[:, None] ** np.arange(depth)  # from time to s
        ends = np.stack([self.knots[:-1], self.knots[1:]], axis=1) * scale[:, None, :, None]
        return _coefficient_matrix(depth) @ ends.reshape(len(steps), 2 * depth, 3)

    def sample(self, start: float, count: int = 65) -> tuple[Floats, Floats]:
        """Return times from `start` to the end, (count,), and the states then, (count, 3, 3)."""
        times = np.linspace(min(start, self.end_time), self.end_time, count)
        return times, self.states(times)

    def sample_segments(self, start: float) -> tuple[Floats, Floats]:
        """Return the times of `sample` and SEGMENT_STEPS more per segment, and the states then."""
        even, fractions = self.sample(start)[0], np.arange(SEGMENT_STEPS) / SEGMENT_STEPS
        inside = (self.times[:-1, None] + np.diff(self.times)[:, None] * fractions).ravel()
        times = np.union1d(even, inside[inside >= start])
        return times, self.states(times)


_EXPONENTS = np.arange(6.0)
_SECOND_FACTORS = _EXPONENTS[2:] * _EXPONENTS[1:-1]


@cache
def _coefficient_matrix(depth: int) -> Floats:
    """Return the matrix from the values at s = 0 and s = 1 to the polynomial's coefficients."""
    size = 2 * depth
    rows = [
        [factorial(j) / factorial(j - d) * s ** (j - d) if j >= d else 0.0 for j in range(size)]
        for s in (0.0, 1.0)
        for d in range(depth)
    ]
    return np.asarray(np.linalg.inv(rows), dtype=float)


def pose_error(pose: npt.ArrayLike, desired: npt.ArrayLike) -> Floats:
    """Return the difference of two poses, (3,), with the heading wrapped to the shorter turn."""
    error = np.asarray(pose, dtype=float) - np.asarray(desired, dtype=float)
    error[2] = wrap(error[2])
    return error
