"""Time scaling of a path in joint space: smooth, and with few knots.

A path q(s) of length S is followed in the time T by

    s(t) = S (10 r^3 - 15 r^4 + 6 r^5),   r = t / T

which starts and ends at rest without jerks. Rates scale with 1 / T, accelerations with 1 / T^2, and
so do torques on a base without momentum (no gravity acts on an air-bearing table).
"""

from collections.abc import Callable

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_motion.plan import PlanError, Start

Path = Callable[[Floats], tuple[Floats, Floats, Floats]]

MAX_KNOT_RATE = 8.0  # most knots per second: links buffer 32 segments, 4 s ahead [1/s]
MIN_KNOT_RATE = 2.0  # fewest knots per second [1/s]
TOLERANCE = 1e-4  # of angles between knots [rad]
COUNT = 201  # number of times at which a path is evaluated


def run_through(r: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the share of the way after a share r of the time, and its first two derivatives."""
    return (
        r**3 * (10.0 - 15.0 * r + 6.0 * r**2),
        30.0 * r**2 * (1.0 - r) ** 2,
        60.0 * r * (1.0 - r) * (1.0 - 2.0 * r),
    )


def shortest(start: Start, path: Path, least: float = 0.5) -> float:
    """Return the shortest time T [s] in which a path q(s), s from 0 to 1, keeps the limits.

    Args:
        start: the limits, and the angular momentum.
        path: angles and their two derivatives by s, (k, n) each, at s (k,).
        least: initial time [s].

    Raises:
        PlanError: no time is long enough.
    """
    s, speed, gain = run_through(np.linspace(0.0, 1.0, COUNT))
    q, slope, bend = path(s)
    rate = slope * speed[:, None]
    acceleration = slope * gain[:, None] + bend * speed[:, None] ** 2
    p, T = start.arm.vector(), least
    for _ in range(60):
        used = start.limits.used(p, q, rate / T, acceleration / T**2, start.L).max(axis=(0, 2))
        if used.max() <= 1.0:
            return T
        T *= max(used[0], np.sqrt(used[1:].max())) * 1.001
    raise PlanError(
        f"an angular momentum of {start.L:g} N m s requires more torque than the joints have"
    )


def knots(
    law: Callable[[Floats], tuple[Floats, Floats]], lasts: float, tolerance: float = TOLERANCE
) -> tuple[Floats, Floats, Floats, float]:
    """Return the fewest evenly spaced knots whose cubics follow a law: times, q, qd, deviation.

    Args:
        law: angles and rates at times (k,), (k, n) each.
        lasts: its duration [s].
        tolerance: of the angles [rad]; exceeded if links cannot buffer enough knots.
    """
    probes = np.linspace(0.0, lasts, COUNT)
    ideal = law(probes)[0]
    segments = max(2, round(MIN_KNOT_RATE * lasts))
    most = max(2, int(MAX_KNOT_RATE * lasts))
    while True:
        times = np.linspace(0.0, lasts, segments + 1)
        q, qd = law(times)
        h, k = lasts / segments, np.minimum((probes / lasts * segments).astype(int), segments - 1)
        x = (probes / h - k)[:, None]
        way = q[k + 1] - q[k]
        v0, v1 = h * qd[k], h * qd[k + 1]
        cubic = q[k] + x * (v0 + x * (3 * way - 2 * v0 - v1 + x * (v0 + v1 - 2 * way)))
        deviation = float(np.abs(cubic - ideal).max())
        if deviation <= tolerance or segments >= most:
            return times, q, qd, deviation
        # The deviation falls with the fourth power of the spacing.
        segments = min(most, max(segments + 1, round(segments * (deviation / tolerance) ** 0.25)))
