"""Reorientation of the base without thrusters, by joints that return to their initial angles.

The constraint G q' = omega is not integrable: a closed path in the space of the joints turns the
base by its integral of G dq, and the reversed path turns it back by the same angle. The shortest
such motion is found in two steps. First, closed polygons from the posture evolve by random changes
of their corners; the best are those that turn the base as requested and whose straight moves take
the least time. Then each of the best is optimized as in transcription.py, with the turn as an
equation. The fastest result is the plan.
"""

import math
from dataclasses import dataclass

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_poses
from fss_arm_model.joint_path import path, sampled
from fss_arm_model.momentum import generalized_jacobian
from fss_arm_model.settings import Check, Settings, at_least, setting
from fss_arm_motion.plan import Plan, PlanError, Start, finished, stretch_to_limits
from fss_arm_motion.point_to_point import MIN_KNOT_TIME, improved, straight

FAMILIES = (
    (3, 1),
    (4, 1),
    (3, 2),
    (4, 2),
    (4, 4),
)  # corners of a polygon, and number of rounds
PARENTS, CHILDREN, GENERATIONS = 16, 16, 25
POLYGON_COUNT = 1500  # random polygons of each family
CHANGE, CHANGE_DECAY = 0.5, 0.93  # of a corner's angles [rad], and its factor per generation
CORNER_TIME = 0.6  # approximate time that a corner costs [s]
SEGMENTS = 3  # segments of each side
NODES = 8  # nodes of the quadrature along a side
ITERATIONS = 100
MAX_OPTIMIZED = 3  # largest number of polygons of a family that are optimized
MAX_TIME_SHARE = 0.9  # largest share of its initial time for a successful optimization
INFEASIBLE_COST = 100.0  # cost of a polygon that is not feasible [s]
CORNER_DISTANCE = 0.02  # distance of corners from joint limits [rad]
GAP_RESERVE = 0.03  # distance between bodies beyond the margin for polygons [m]
TURN_TOLERANCE = math.radians(0.02)  # tolerance of the turn


@dataclass(frozen=True)
class Reorientation(Settings):
    """A turn of the base, after which the arm is back in its posture.

    Raises:
        SettingError: the turn is 0.
    """

    angle: float = setting(
        math.radians(30.0),
        "turn of the base",
        unit="rad",
        check=Check("-pi to pi, and not 0", lambda x: 0.0 < abs(x) <= math.pi, -math.pi, math.pi),
    )
    seed: int = setting(0, "seed of the search", check=at_least(0))


def along(corners: Floats) -> tuple[Floats, Floats, Floats]:
    """Return postures on the sides of closed polygons (k, c, n), the sides, and the weights."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    sides = np.roll(corners, -1, axis=1) - corners
    q = corners[:, :, None] + (0.5 * x[:, None] + 0.5) * sides[:, :, None]
    return q, sides, 0.5 * w


def turns_of(start: Start, corners: Floats) -> Floats:
    """Return turns of the base by closed polygons, (k,) [rad], for corners (k, c, n) [rad]."""
    q, sides, w = along(corners)
    state = np.concatenate([np.zeros((*q.shape[:-1], 3)), q], axis=-1)
    G = generalized_jacobian(start.bodies, state)[..., 2, :] - 1.0
    return np.asarray(np.einsum("kcxn,kcn,x->k", G, sides, w))


def costs(start: Start, corners: Floats, turn: float) -> Floats:
    """Return approximate times of polygons (k, c, n), shrunk to the turn `turn`, (k,) [s].

    A polygon that turns the base less, or in which bodies come too near to each other, has an
    additional cost that grows with the violation.
    """
    sides = np.roll(corners, -1, axis=1) - corners
    travel = (np.abs(sides) / start.limits.rate).max(axis=2)
    turns = turns_of(start, corners) / turn
    # The turn grows about as the square of a polygon's size.
    size = np.minimum(1.0, np.sqrt(1.0 / np.maximum(turns, 1e-9)))
    spent = (size[:, None] * travel + CORNER_TIME).sum(axis=1)
    spent += np.where(turns < 1.0, INFEASIBLE_COST * (2.0 - turns), 0.0)
    lack = start.limits.margin + GAP_RESERVE - start.gap(along(corners)[0]).min(axis=(1, 2))
    return np.asarray(spent + np.where(lack > 0.0, 3.0 * INFEASIBLE_COST * (1.0 + lack), 0.0))


def polygons(
    start: Start, turn: float, corners: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return closed polygons (k, c, n) from the posture and their costs (k,), the best first."""
    low, high = start.limits.bounds.T
    low, high = low + CORNER_DISTANCE, high - CORNER_DISTANCE
    found = rng.uniform(low, high, (POLYGON_COUNT, corners, start.arm.n))
    found[:, 0] = start.q
    cost = costs(start, found, turn)
    order = np.argsort(cost)[:PARENTS]
    found, cost = found[order], cost[order]
    for generation in range(GENERATIONS):
        change = CHANGE * CHANGE_DECAY**generation
        new = np.repeat(found, CHILDREN, axis=0)
        some = rng.random(new.shape[:2]) < 0.6
        new += change * rng.standard_normal(new.shape) * some[..., None]
        new = new.clip(low, high)
        new[:, 0] = start.q
        own = costs(start, new, turn).reshape(PARENTS, CHILDREN)
        best = own.argmin(axis=1)
        better = own.min(axis=1) < cost
        found = np.where(
            better[:, None, None],
            new.reshape(PARENTS, CHILDREN, corners, -1)[np.arange(PARENTS), best],
            found,
        )
        cost = np.where(better, own.min(axis=1), cost)
    order = np.argsort(cost)
    return found[order], cost[order]


def _sized(start: Start, corners: Floats, turn: float) -> Floats:
    """Shrink a polygon towards its first corner until it turns the base by `turn`."""
    low, high = 0.0, 1.0
    for _ in range(6):  # each iteration divides the interval by 16
        sizes = np.linspace(low, high, 17)
        tried = corners[0] + sizes[:, None, None] * (corners - corners[0])
        k = int(np.argmax(turns_of(start, tried) / turn >= 1.0))
        low, high = sizes[max(k - 1, 0)], sizes[k]
    return np.asarray(corners[0] + high * (corners - corners[0]))


def reorientation(start: Start, request: Reorientation) -> Plan:
    """Plan the motion.

    Raises:
        PlanError: no motion found turns the base that far.
    """
    rng = np.random.default_rng(request.seed)
    arguments = {"angle": request.angle, "seed": request.seed}
    best: Plan | None = None
    largest_turn = 0.0
    for corners, rounds in FAMILIES:
        if best is not None and rounds > best.notes["rounds"]:
            break
        turn = request.angle / rounds
        found, cost = polygons(start, turn, corners, rng)
        largest_turn = max(largest_turn, float((turns_of(start, found) / turn).max()))
        # Optimize the best one; if that fails the next ones, and at last use the best unchanged.
        for k, improve in (*((k, True) for k in range(MAX_OPTIMIZED)), (0, False)):
            if not cost[k] < INFEASIBLE_COST:
                break
            one = _sized(start, found[k], turn)
            ways = np.concatenate([np.tile(one, (rounds, 1)), one[:1]])
            try:
                plan = _timed(start, ways, request.angle, arguments, rounds, improve)
            except PlanError:
                continue
            if plan.duration < MAX_TIME_SHARE * _spent(start, ways) or not improve:
                best = plan if best is None or plan.duration < best.duration else best
                break
    if best is None:
        turn = np.degrees(largest_turn * abs(request.angle))
        raise PlanError(
            f"angle is {np.degrees(request.angle):.1f} deg: no closed motion from this posture was "
            f"found that turns the base by more than {turn:.1f} deg"
        )
    return best


def _spent(start: Start, ways: Floats) -> float:
    """Return the time of straight moves [s]."""
    return float(straight(start, ways, SEGMENTS)[0].sum())


def _timed(
    start: Start,
    ways: Floats,
    angle: float,
    arguments: dict[str, float],
    rounds: int,
    improve: bool,
) -> Plan:
    """Return the motion along a closed polygon, or the best one near it.

    Raises:
        PlanError: limits cannot be kept, or the turn is not the requested one.
    """
    h, q, qd = straight(start, ways, SEGMENTS)
    turn, times = angle, np.append(0.0, np.cumsum(h))
    for _ in range(3):  # slowing down between knots changes the momentum's part
        if improve:
            h, q, qd, _ = improved(
                start,
                h,
                q,
                qd,
                least=MIN_KNOT_TIME,
                turn=turn,
                iterations=ITERATIONS,
                tolerance=5e-3,
            )
        times, qd, _ = stretch_to_limits(start, np.append(0.0, np.cumsum(h)), q, qd)
        h = np.diff(times)
        missing = angle - _turn(start, times, q, qd)
        turn += missing
        if abs(missing) < TURN_TOLERANCE:
            return finished(start, "reorientation", arguments, times, q, qd, {"rounds": rounds})
    raise PlanError(f"the base turns by {np.degrees(angle - missing):.2f} deg")


def _turn(start: Start, times: Floats, q: Floats, qd: Floats) -> float:
    n = start.arm.n
    law, edges = sampled([times] * n, list(q.T), list(qd.T))
    state = np.concatenate([np.zeros(3), start.momentum, np.zeros(2)])
    poses = base_poses(start.bodies, path(law, edges, times[[0, -1]]), state)
    return float(poses[-1, 2])
