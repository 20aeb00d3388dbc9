"""Knots of a joint's timed path, checked against its limits, in a link's counts."""

from collections.abc import Iterator, Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np

from fss_arm_driver.protocol import MAX_INDEX, hermite
from fss_arm_driver.scale import Scale
from fss_arm_model.arrays import Floats
from fss_link.session import CommandError

MIN_INTERVAL, MAX_INTERVAL = (
    2000,
    59_000_000,
)  # between knots; the protocol allows slightly more, for clock drift [us]
TOLERANCE = 1e-6  # of limits [rad, rad/s]


class Knot(NamedTuple):
    """State of the joint at one time."""

    time: int  # since the start of the path [us]
    position: int  # [counts]
    velocity: int  # [0.1 counts/s]


def knots(
    scale: Scale, time: Sequence[float], position: Sequence[float], velocity: Sequence[float]
) -> tuple[Knot, ...]:
    """Convert a path of cubic Hermite polynomials to the knots of a link.

    Args:
        scale: the link's units and limits.
        time: (n) ascending from 0 [s].
        position: (n) of the joint [rad].
        velocity: (n) of the joint [rad/s].

    Raises:
        CommandError: they are no valid path, or exceed the joint's limits.
    """
    lengths = len(time), len(position), len(velocity)
    if len(set(lengths)) > 1 or not 2 <= len(time) <= MAX_INDEX + 2:
        raise CommandError(
            f"time, position and velocity have {lengths[0]}, {lengths[1]} and {lengths[2]} values, "
            f"expected as many of each, 2 to {MAX_INDEX + 2}"
        )
    for name, values in (("time", time), ("position", position), ("velocity", velocity)):
        for k in np.flatnonzero(~np.isfinite(values)).tolist():
            raise CommandError(f"{name}[{k}] is {values[k]}, expected a finite number")
    if time[0] != 0.0:
        raise CommandError(f"time[0] is {time[0]:g} s, expected 0")
    if velocity[-1] != 0.0:
        raise CommandError(f"the last velocity is {velocity[-1]:g} rad/s, expected 0")
    with np.errstate(over="ignore", invalid="ignore"):
        clocks = np.rint(1e6 * np.asarray(time))
        steps = np.diff(clocks)
    for k in np.flatnonzero((steps < MIN_INTERVAL) | (steps > MAX_INTERVAL)).tolist():
        raise CommandError(
            f"time[{k + 1}] is {1e-6 * steps[k]:g} s after the one before, expected "
            f"{1e-6 * MIN_INTERVAL:g} to {1e-6 * MAX_INTERVAL:g} s"
        )
    q, qd = np.asarray(position), np.asarray(velocity)
    for k in _doubtful_segments(scale, np.asarray(time), q, qd):
        _check_limits(scale, k, time, position, velocity)
    counts = np.rint(q / scale.radians_per_count), np.rint(qd / scale.radians_per_raw_velocity)
    return tuple(map(Knot, *np.stack([clocks, *counts]).astype(int).tolist()))


def _doubtful_segments(scale: Scale, time: Floats, q: Floats, qd: Floats) -> list[int]:
    """Return the index of the last knot of each segment that may exceed a limit of the joint.

    A cubic and its velocity stay between their Bezier control points.
    """
    link, h = scale.link, np.diff(time)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is doubtful
        angles = np.stack([q[:-1], q[:-1] + h * qd[:-1] / 3.0, q[1:] - h * qd[1:] / 3.0, q[1:]])
        rates = np.stack([qd[:-1], 3.0 * np.diff(q) / h - qd[:-1] - qd[1:], qd[1:]])
    inside = (angles >= link.q_min) & (angles <= link.q_max)
    slow = np.abs(rates) <= link.drive.max_velocity
    return (np.flatnonzero(~(inside.all(axis=0) & slow.all(axis=0))) + 1).tolist()


def _check_limits(
    scale: Scale, k: int, time: Sequence[float], q: Sequence[float], qd: Sequence[float]
) -> None:
    """Check that the cubic that ends at knot k is within the joint's limits."""
    link, fastest = scale.link, scale.link.drive.max_velocity
    cubic = time[k] - time[k - 1], q[k - 1], qd[k - 1], q[k], qd[k]
    for t in _turning_points(*cubic):
        angle, rate = hermite(t, *cubic)
        if not link.q_min - TOLERANCE <= angle <= link.q_max + TOLERANCE:
            raise CommandError(
                f"position is {angle:.6g} rad between knots {k - 1} and {k}, "
                f"expected {link.q_min:.6g} to {link.q_max:.6g}"
            )
        if abs(rate) > fastest + TOLERANCE:
            raise CommandError(
                f"velocity is {rate:.6g} rad/s between knots {k - 1} and {k}, "
                f"expected at most {fastest:.6g}"
            )


def _turning_points(duration: float, p0: float, v0: float, p1: float, v1: float) -> Iterator[float]:
    """Yield the times of possible extremes of a cubic or its velocity: ends and turning points."""
    yield from (0.0, duration)
    rise, a, b = p1 - p0, duration * v0, duration * v1
    square, cube = 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise
    # p' T = a + 2 square s + 3 cube s^2, p'' T^2 = 2 square + 6 cube s, in s = t / T
    roots = [-square / (3.0 * cube)] if cube else []
    if (inner := square * square - 3.0 * cube * a) > 0.0:
        far = -square - (sqrt(inner) if square > 0.0 else -sqrt(inner))  # no difference of equals
        roots += [far / (3.0 * cube)] if cube else []
        roots += [a / far] if far else []
    yield from (s * duration for s in roots if 0.0 < s < 1.0)
