"""The base's pose and twist from VICON poses and gyro rates.

Position and heading are unrelated for a filter that knows no forces, and x and y are alike: one
Kalman filter of position and velocity, whose covariance x and y share, and one of heading, rate and
the gyro's bias. Accelerations are white noise (Bar-Shalom, Li, Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001, section 6.2.2).
"""

from bisect import insort
from collections import Counter
from collections.abc import Callable
from math import isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .settings import SensorErrors

Floats = npt.NDArray[np.float64]

MAX_LAG = 50_000_000  # of a stream behind the other [ns]
GATE = 5.0  # standard deviations beyond which a measurement is rejected
MAX_REJECTED = 10  # poses in a row after which the next one is believed


class BaseState(NamedTuple):
    """The base at a moment, estimated."""

    t: int  # [ns]
    pose: Floats  # (3,) x, y [m], unwrapped heading [rad]
    twist: Floats  # (3,) [m/s, m/s, rad/s]
    pose_variance: Floats  # (3,)
    twist_variance: Floats  # (3,)

    def at(self, t: int) -> "BaseState":
        """The same motion a little earlier or later."""
        return self._replace(t=t, pose=self.pose + (t - self.t) * 1e-9 * self.twist)


class _Kalman:
    """One filter: state x (k,) or (k, c) for c alike, its covariance P (k, k)."""

    def __init__(self, x: Floats, variances: tuple[float, ...], densities: tuple[float, ...]):
        self.x, self.P = x, np.diag(variances)
        self.densities = densities  # of the noise driving rate, and what follows it

    def predict(self, dt: float, acceleration: Floats | float = 0.0) -> None:
        """The first state moves with the second, which is driven by noise beside what is known."""
        F = np.eye(len(self.P))
        F[0, 1] = dt
        Q = np.zeros_like(self.P)
        Q[:2, :2] = self.densities[0] * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        for i, density in enumerate(self.densities[1:], 2):
            Q[i, i] = density * dt
        self.x = F @ self.x
        self.x[0] += 0.5 * dt**2 * acceleration
        self.x[1] += dt * acceleration
        self.P = F @ self.P @ F.T + Q

    def distance(self, h: Floats, innovation: Floats | float, variance: float) -> float:
        """The innovation in its deviations; the largest, where states are alike."""
        return float(np.abs(innovation).max() / sqrt(h @ self.P @ h + variance))

    def update(self, h: Floats, innovation: Floats | float, variance: float) -> None:
        """Take a measurement h x with the given innovation."""
        Ph = self.P @ h
        gain = Ph / (h @ Ph + variance)
        self.x = self.x + (np.outer(gain, innovation) if self.x.ndim == 2 else gain * innovation)
        self.P = self.P - np.outer(gain, Ph)


_POSITION = np.array([1.0, 0.0])
_HEADING = np.array([1.0, 0.0, 0.0])
_GYRO = np.array([0.0, 1.0, 1.0])


class BaseFilter:
    """Merges the two streams by their stamps; one may lag the other by MAX_LAG.

    A measurement further than GATE deviations off, or older than what was merged already, is
    rejected and counted; after MAX_REJECTED poses in a row the base is believed to be there.

    Args:
        errors: of the sensors, and what accelerates the base beside what is known.
        acceleration: the mean acceleration in the world, (3,), that is known to act from one time
            [ns] to another, as by thrusters; none by default.
    """

    def __init__(
        self,
        errors: SensorErrors | None = None,
        acceleration: Callable[[int, int], Floats] | None = None,
    ) -> None:
        self.errors = errors or SensorErrors()
        self.acceleration = acceleration or (lambda begin, end: np.zeros(3))
        self.rejected: Counter[str] = Counter()
        self.buffer: list[tuple[int, int, tuple[float, ...]]] = []
        self.t = -1
        self.streak = 0  # of rejected poses
        self.position: _Kalman | None = None
        self.heading: _Kalman | None = None

    def pose(self, t: int, x: float, y: float, heading: float) -> list[BaseState]:
        """Take a VICON pose at t [ns]; return the estimates at all poses merged by it."""
        return self._take(t, (x, y, heading))

    def rate(self, t: int, omega: float) -> list[BaseState]:
        """Take a gyro sample at t [ns]; return the estimates at all poses merged by it."""
        if not isfinite(omega):
            self.rejected["gyro not finite"] += 1
            return []
        return self._take(t, (omega,))

    def _take(self, t: int, sample: tuple[float, ...]) -> list[BaseState]:
        if t < self.t:
            self.rejected["late"] += 1
            return []
        insort(self.buffer, (t, len(sample), sample))
        until, merged = self.buffer[-1][0] - MAX_LAG, 0
        found = []
        for at, size, values in self.buffer:
            if at > until:
                break
            merged += 1
            if size == 1:
                self._merge_rate(at, values[0])
            elif self._merge_pose(at, values):
                found.append(self._estimate())
        del self.buffer[:merged]
        return found

    def _move(self, t: int) -> None:
        assert self.position is not None
        assert self.heading is not None
        dt, a = (t - self.t) * 1e-9, self.acceleration(self.t, t)
        self.position.predict(dt, a[:2])
        self.heading.predict(dt, float(a[2]))
        self.t = t

    def _merge_rate(self, t: int, omega: float) -> None:
        if self.heading is None:
            return
        self._move(t)
        variance = self.errors.rate_error**2
        innovation = omega - _GYRO @ self.heading.x
        if self.heading.distance(_GYRO, innovation, variance) > GATE and self.streak < MAX_REJECTED:
            self.rejected["gyro"] += 1
            return
        self.heading.update(_GYRO, innovation, variance)

    def _merge_pose(self, t: int, pose: tuple[float, ...]) -> bool:
        e = self.errors
        if self.position is None or self.heading is None or self.streak >= MAX_REJECTED:
            self._begin(t, pose)
            return True
        self._move(t)
        away = np.array(pose[:2]) - self.position.x[0]
        turned = (pose[2] - self.heading.x[0] + pi) % (2 * pi) - pi
        off = max(
            self.position.distance(_POSITION, away, e.position_error**2),
            self.heading.distance(_HEADING, turned, e.heading_error**2),
        )
        if off > GATE:
            self.rejected["pose"] += 1
            self.streak += 1
            return False
        self.streak = 0
        self.position.update(_POSITION, away, e.position_error**2)
        self.heading.update(_HEADING, turned, e.heading_error**2)
        return True

    def _begin(self, t: int, pose: tuple[float, ...]) -> None:
        e, turns = self.errors, 0.0
        if self.heading is not None:
            turns = 2 * pi * round((self.heading.x[0] - pose[2]) / (2 * pi))
        self.t, self.streak = t, 0
        self.position = _Kalman(
            np.array([pose[:2], (0.0, 0.0)]), (e.position_error**2, 0.1**2), (e.acceleration**2,)
        )
        self.heading = _Kalman(
            np.array([pose[2] + turns, 0.0, 0.0]),
            (e.heading_error**2, 0.1**2, 0.01**2),
            (e.angular_acceleration**2, e.bias_walk**2),
        )

    def _estimate(self) -> BaseState:
        assert self.position is not None
        assert self.heading is not None
        (x, y), (vx, vy) = self.position.x
        heading, omega, _ = self.heading.x
        line, turn = np.diag(self.position.P), np.diag(self.heading.P)
        return BaseState(
            self.t,
            np.array([x, y, heading]),
            np.array([vx, vy, omega]),
            np.array([line[0], line[0], turn[0]]),
            np.array([line[1], line[1], turn[1]]),
        )
