"""Motion between postures: as fast as limits allow, or with least turn of the base in a given time.

No move is shorter than its longest joint alone would need. On a floating base the torque of each
joint depends on all joints, so other joints can help it: the path between the postures is free. It
is optimized as in transcription.py, starting from a straight motion.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.joint_path import sampled
from fss_arm_model.settings import FINITE, NOT_NEGATIVE, Settings, setting
from fss_arm_model.units import in_degrees
from fss_arm_motion.interior_point import optimized
from fss_arm_motion.plan import Plan, PlanError, Start, finished, probed, stretch_to_limits

SEGMENTS = 6  # of a short move; two for each limit between which the best motion switches
MIN_KNOT_TIME = 0.125  # least time between knots [s]; links keep 32 knots, for 4 s
KNOTS_PER_SECOND = 3.0  # knots per second of a long move
MIN_DISTANCE = 1e-6  # shortest distance that is a motion [rad]
INITIAL_SHARE = 0.9  # share of the limits that an initial motion uses
TURN_WEIGHT = 1e4  # weight of the base's mean square rate relative to the accelerations' [s^2]
LIMIT_DISTANCES = (1e-3, 1e-2, 5e-2)  # distances of knots from limits, tried in this order [rad]
GAP_PER_DISTANCE = 1.0  # distance of bodies that are not neighbours per such distance [m/rad]


@dataclass(frozen=True)
class PointToPoint(Settings):
    """A motion from the current posture to another."""

    goal: tuple[float, ...] = setting((), "joint readings to arrive at", unit="rad", check=FINITE)
    duration: float = setting(
        0.0, "time to take; 0: as short as limits allow", unit="s", check=NOT_NEGATIVE
    )
    least_rotation: bool = setting(
        False, "turn the base as little as possible, in the duration or else in twice the least"
    )


def straight(
    start: Start, ways: npt.ArrayLike, segments: int, share: float = INITIAL_SHARE
) -> tuple[Floats, Floats, Floats]:
    """Return h, q and qd at knots of straight moves between postures, from rest to rest.

    Each is as fast as a share of the limits allows, with a rate that is a parabola over time.

    Raises:
        PlanError: limits cannot be kept.
    """
    x = np.linspace(0.0, 1.0, segments + 1)
    way, rate = x**2 * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x)
    h, q, qd = [], [np.asarray(ways, dtype=float)[0][None]], [np.zeros((1, start.arm.n))]
    for begin, end in zip(np.asarray(ways)[:-1], np.asarray(ways)[1:], strict=True):
        d = end - begin
        lasts = max(
            float((1.5 * np.abs(d) / start.limits.rate).max()),
            sqrt(float((6.0 * np.abs(d) / start.limits.acceleration).max())),
            segments * MIN_KNOT_TIME,
        )
        knots, rates = begin + way[:, None] * d, rate[:, None] * d / lasts
        times = stretch_to_limits(start, lasts * x, knots, rates)[0]
        slower = times[-1] / lasts / share
        h.append(np.diff(times) / share)
        q.append(knots[1:])
        qd.append(rates[1:] / slower)
    return np.concatenate(h), np.concatenate(q), np.concatenate(qd)


def floor(start: Start, goal: Floats) -> float:
    """Return a lower bound of the time to the goal [s]: each joint alone, trapezoidal."""
    way, v, a = np.abs(goal - start.q), start.limits.rate, start.limits.acceleration
    alone = np.where(way > v**2 / a, way / v + v / a, 2.0 * np.sqrt(way / a))
    return float(alone.max())


def improved(
    start: Start, h: Floats, q: Floats, qd: Floats, **options: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Optimize a motion with interior_point.optimized, with its cubics within the joints' angles.

    Knots keep a small distance from the limits, because a cubic may exceed them in between; a
    larger one if that was not enough. A joint that starts or ends at its limit may stay at it.
    """
    low, high = start.limits.bounds.T
    near = np.minimum(q - low, high - q)[[0, -1]].min(axis=0)
    margin = min(start.limits.margin, float(start.gap(q[[0, -1]]).min()))
    for keep in LIMIT_DISTANCES:
        off = np.where(near < 2.0 * keep, 0.0, np.minimum(keep, 0.1 * (high - low)))
        knots = q.copy()
        knots[1:-1] = q[1:-1].clip(low + 2.0 * keep, high - 2.0 * keep)
        found = optimized(
            start.arm.vector(),
            np.column_stack([low + off, high - off]),
            start.limits.table,
            start.limits.rotor,
            [*start.limits.radii, margin + GAP_PER_DISTANCE * keep],
            h,
            knots,
            qd,
            momentum=start.L,
            **options,
        )
        times = np.append(0.0, np.cumsum(found[0]))
        angles = probed(times, *found[1:3])[0]
        clear = start.gap(angles).min() >= margin - 1e-9 and not start.limits.outside(angles)
        if found[3][0] > 0.0 and clear:
            return found
    return h, q, qd, found[3]


def point_to_point(start: Start, request: PointToPoint) -> Plan:
    """Plan the motion to a posture.

    Raises:
        PlanError: the goal is beyond limits, or the duration shorter than they allow.
    """
    goal = start.posture("goal", request.goal)
    arguments = {
        "goal": goal.tolist(),
        "duration": request.duration,
        "least_rotation": request.least_rotation,
    }
    if np.abs(goal - start.q).max() < MIN_DISTANCE:
        raise PlanError(f"goal is {in_degrees(goal)}, where the arm is")
    least = floor(start, goal)
    segments = max(
        2, min(max(SEGMENTS, round(KNOTS_PER_SECOND * least)), int(least / MIN_KNOT_TIME))
    )
    h, q, qd = straight(start, [start.q, goal], segments)
    h, q, qd, _ = improved(start, h, q, qd, least=MIN_KNOT_TIME, floor=least)
    times, qd, _ = stretch_to_limits(start, np.append(0.0, np.cumsum(h)), q, qd)
    fastest = float(times[-1])
    lasts = request.duration or fastest * (2.0 if request.least_rotation else 1.0)
    if lasts < fastest:
        raise PlanError(
            f"duration is {lasts:g} s, expected {fastest:.3f} s or more: "
            f"{_bound(start, times, q, qd)}"
        )
    qd, times = qd * (fastest / lasts), times * (lasts / fastest)
    if request.least_rotation:
        segments = max(SEGMENTS, min(round(KNOTS_PER_SECOND * lasts), 24))
        q, qd = _resampled(times, q, qd, segments)
        h = np.full(segments, lasts / segments)
        h, q, qd, _ = improved(
            start,
            h,
            q,
            qd,
            time_weight=0.0,
            turn_weight=TURN_WEIGHT,
            tolerance=1e-5,
            iterations=75,
        )
        times = np.append(0.0, np.cumsum(h))
    notes = {"least_possible": least}
    return finished(start, "point_to_point", arguments, times, q, qd, notes)


def _bound(start: Start, times: Floats, q: Floats, qd: Floats) -> str:
    return finished(start, "", {}, times, q, qd).bound


def _resampled(times: Floats, q: Floats, qd: Floats, segments: int) -> tuple[Floats, Floats]:
    """Return evenly spaced knots on a path."""
    n = q.shape[1]
    law, _ = sampled([times] * n, list(q.T), list(qd.T))
    return law(np.linspace(0.0, times[-1], segments + 1))
