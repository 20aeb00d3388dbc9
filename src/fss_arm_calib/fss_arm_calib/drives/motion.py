"""Motion of the arm from its encoders, without their periodic errors.

An encoder on a harmonic drive's motor has an error of two periods per turn of the motor, that is,
P = 2 N periods per turn of the joint (Tuttle & Seering 1996):

    reading = q + A sin(P q) + B cos(P q)

The error is small, but in accelerations it is multiplied by P^2. The reported rates are derivatives
of the reading, with the same error. It shows in samples that are far apart: at constant
acceleration, the joint satisfies the trapezoidal rule, but its readings do not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.estimation.least_squares import Mask

TRAPEZOID_STEP = 0.2  # approximate time between samples for the trapezoidal rule [s]
KNOT_SPACING = 0.05  # least time between samples used to interpolate the motion [s]
REWEIGHTINGS = 10  # reweighting iterations: the rule does not hold where the acceleration changes


@dataclass(frozen=True)
class Samples:
    """Telemetry of a link in SI units, in order of time, (k,) each."""

    t: Floats  # [s]
    q: Floats  # [rad]
    qd: Floats  # [rad/s]
    current: Floats  # counter-clockwise positive [A]
    torque: Floats  # with the described gain and zero [N m]
    age: Floats  # age of the torque sample at t [s]

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.t)))


class ArmMotion(NamedTuple):
    """Motion of the arm at k times."""

    q: Floats  # (k, n) [rad]
    qd: Floats  # [rad/s]
    qdd: Floats  # [rad/s^2]


def estimate_ripple(s: Samples, periods: float) -> tuple[float, float]:
    """Estimate A and B of the encoder's error [rad]."""
    step = max(1, round(TRAPEZOID_STEP / s.period))
    t, q, qd = s.t[::step], s.q[::step], s.qd[::step]
    half = 0.5 * np.diff(t)
    phase, rate = periods * q, periods * qd
    rows = []
    for value, slope in ((np.sin(phase), np.cos(phase)), (np.cos(phase), -np.sin(phase))):
        slope = slope * rate
        rows.append(np.diff(value) - half * (slope[1:] + slope[:-1]))
    error = np.diff(q) - half * (qd[1:] + qd[:-1])
    keep = (half < step * s.period) & (qd[1:] != 0.0)
    if not keep.any():
        return 0.0, 0.0
    A, e = np.column_stack(rows)[keep], error[keep]
    weight = np.ones(len(e))
    found = np.zeros(2)
    for _ in range(REWEIGHTINGS):
        normal = A.T @ (weight[:, None] * A) + 1e-12 * np.eye(2)
        found = np.linalg.solve(normal, A.T @ (weight * e))
        left = e - A @ found
        scale = 1.48 * np.median(np.abs(left)) + 1e-9
        weight = 1.0 / (1.0 + (left / (2.0 * scale)) ** 2)
    return float(found[0]), float(found[1])


def remove_ripple(s: Samples, periods: float, of: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return angles and rates without the encoder's error."""
    q = s.q
    for _ in range(3):
        off = of[0] * np.sin(periods * q) + of[1] * np.cos(periods * q)
        q = s.q - off
    slope = periods * (of[0] * np.cos(periods * q) - of[1] * np.sin(periods * q))
    return q, s.qd / (1.0 + slope)


def common_intervals(samples: Sequence[Samples], gap: float) -> Iterator[tuple[float, float]]:
    """Yield time spans in which all links send telemetry, without gaps longer than `gap` [s]."""
    last = max(s.t[0] for s in samples)
    steps = ((s.t, np.flatnonzero(np.diff(s.t) > gap)) for s in samples)
    for begin, end in sorted((t[k], t[k + 1]) for t, which in steps for k in which.tolist()):
        yield last, begin
        last = max(last, end)
    yield last, min(s.t[-1] for s in samples)


class Motion:
    """Motion of all joints, interpolated between their samples."""

    def __init__(self, samples: Sequence[Samples], periods: float, gap: float) -> None:
        from scipy.interpolate import CubicHermiteSpline  # slow import, not needed by --help

        self._splines = []
        for s in samples:
            q, qd = remove_ripple(s, periods, estimate_ripple(s, periods))
            step = max(1, round(KNOT_SPACING / s.period))
            self._splines.append(CubicHermiteSpline(s.t[::step], q[::step], qd[::step]))
        self.width = [max(KNOT_SPACING, s.period) for s in samples]  # to differentiate rates [s]
        margin = 2.0 * max(self.width)
        every = ((begin + margin, end - margin) for begin, end in common_intervals(samples, gap))
        self.runs = [(begin, end) for begin, end in every if begin < end]  # known motion [s]

    def is_known(self, t: Floats) -> Mask:
        """Return a mask (k,), True where the motion is known at times t."""
        return np.any([(t > begin) & (t < end) for begin, end in self.runs], axis=0)

    def at(self, t: Floats) -> ArmMotion:
        """Return the motion at times (k,)."""
        q, qd, qdd = (np.column_stack([f(t, k) for f in self._splines]) for k in range(3))
        return ArmMotion(q, qd, qdd)

    def rates(self, t: Floats, j: int) -> Floats:
        """Return the rates (k,) of joint j, counted from 0."""
        return np.asarray(self._splines[j](t, 1))
