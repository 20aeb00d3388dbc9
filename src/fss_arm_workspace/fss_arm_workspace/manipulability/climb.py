"""Posture of largest manipulability with the tip at a given point.

Arguments of all functions: p (..., 8 + 6 n) is Arm.vector(), q_m (..., n) the joint readings [rad],
limits (..., n, 2) the lowest and highest readings, kind the kind of measure (measure.py).
Leading dimensions broadcast. The kernels use the notation of self_motion.py.
"""

import math

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import checked, dot
from fss_arm_workspace.manipulability.measure import FIXED, Kind, fixed_jacobian, square_measure
from fss_arm_workspace.manipulability.self_motion import (
    MAX_STEP,
    move_tip,
    self_motions,
    solve_joints,
    turn_vectors,
)

_AT_LIMIT = 1e-7  # distance below which a joint is at its limit [rad]
_CONVERGED = 1e-3  # length of a step after which Newton's method has converged [rad]
_MIN_SLOPE = 1e-8  # slope of w^2 below which it counts as zero [m^4/rad]


@helper
def _gradient(p, d, e, kind, d2, e2, J, x, g):  # type: ignore[no-untyped-def]
    """Write the derivative of w^2 by the joint angles, g (n,), from central differences."""
    step = 1e-5
    x[:] = 0.0
    for k in range(g.size):
        x[k] = step
        turn_vectors(d, e, x, 1.0, d2, e2)
        above = square_measure(p, d2, e2, kind, J)
        turn_vectors(d, e, x, -1.0, d2, e2)
        g[k] = (above - square_measure(p, d2, e2, kind, J)) / (2.0 * step)
        x[k] = 0.0


@helper
def _release_joints(limits: Floats, q: Floats, J: Floats, g: Floats, free: Floats) -> None:
    """Write which joints are free (n,): those within their limits, and those that gain by leaving.

    With the multipliers y of the free joints, J^T y = g, joint k gains g_k - J_k . y per radian.
    """
    for k in range(free.size):
        room = min(q[3 + k] - limits[k, 0], limits[k, 1] - q[3 + k])
        free[k] = 1.0 if room > _AT_LIMIT else 0.0
    for _ in range(free.size):
        a = b = 0.0
        for k in range(free.size):
            a += free[k] * J[0, k] * g[k]
            b += free[k] * J[1, k] * g[k]
        y = solve_joints(J, free, a, b)
        best, largest = -1, _MIN_SLOPE
        for k in range(free.size):
            gain = g[k] - dot(complex(J[0, k], J[1, k]), y)
            if limits[k, 1] - q[3 + k] <= _AT_LIMIT:
                gain = -gain
            if free[k] == 0.0 and gain > largest:
                best, largest = k, gain
        if best < 0:
            break
        free[best] = 1.0


@helper
def _curvature(  # type: ignore[no-untyped-def]
    p, d, e, kind, square, free, J, Z, count, d2, e2, J2, x, H
):
    """Write the second derivatives of w^2 along the self-motions Z, H (count, count).

    They are central differences of w^2, after the tip has been moved back to its position.
    """
    step = 1e-3
    tip = 0j
    for k in range(d.size):
        tip += d[k]
    for i in range(count):
        for j in range(i + 1):
            total = -2.0 * square
            for sign in (-step, step):
                for k in range(x.size):
                    x[k] = sign * (Z[i, k] if i == j else Z[i, k] + Z[j, k])
                for _ in range(2):
                    turn_vectors(d, e, x, 1.0, d2, e2)
                    error = tip
                    for k in range(d.size):
                        error -= d2[k]
                    y = solve_joints(J, free, error.real, error.imag)
                    for k in range(x.size):
                        x[k] += free[k] * dot(complex(J[0, k], J[1, k]), y)
                turn_vectors(d, e, x, 1.0, d2, e2)
                total += square_measure(p, d2, e2, kind, J2)
            H[i, j] = total / (step * step)
    for i in range(count):
        for j in range(i):
            H[i, j] = H[j, i] = 0.5 * (H[i, j] - H[i, i] - H[j, j])


@helper
def _ascent_step(H: Floats, b: Floats, count: int, L: Floats, u: Floats) -> None:
    """Write u = (mu I - H)^-1 b with the least tried mu >= 0 for which u leads uphill."""
    mu, is_definite = 0.0, False
    while not is_definite:
        is_definite = True
        for i in range(count):
            for j in range(i + 1):
                remainder = -H[i, j]
                for k in range(j):
                    remainder -= L[i, k] * L[j, k]
                if i != j:
                    L[i, j] = remainder / L[j, j]
                elif remainder + mu > 1e-9:
                    L[i, i] = math.sqrt(remainder + mu)
                else:
                    is_definite = False
            if not is_definite:
                mu = max(4.0 * mu, 1e-3)
                break
    for i in range(count):
        remainder = b[i]
        for k in range(i):
            remainder -= L[i, k] * u[k]
        u[i] = remainder / L[i, i]
    for i in range(count - 1, -1, -1):
        remainder = u[i]
        for k in range(i + 1, count):
            remainder -= L[k, i] * u[k]
        u[i] = remainder / L[i, i]


@kernel("(p),(n,k),(k),(k),(n),()->(n),()")
def _climb(p, limits, kind_, point, start, steps, q_m, w):  # type: ignore[no-untyped-def]
    n, kind = start.size, Kind(kind_[0], kind_[1])
    d, e, d2, e2 = np.empty((4, n + 1), np.complex128)
    q, trial = np.zeros((2, 3 + n))
    J, J2 = np.empty((2, 3, n))
    free, free2, movable, g, x, b, u = np.ones((7, n))
    Z, H, L = np.empty((3, n + 2, n))
    q[3:] = start
    target = complex(point[0], point[1])
    if not move_tip(p, limits, target, q, d, e, J, free, movable):
        q_m[:], w[0] = math.nan, math.nan
        return
    square = square_measure(p, d, e, kind, J)
    for _ in range(int(steps[0])):
        _gradient(p, d, e, kind, d2, e2, J2, x, g)
        fixed_jacobian(d, J)
        _release_joints(limits, q, J, g, free)
        steepest, longest, blocked = 0.0, 0.0, 0
        while blocked >= 0:  # a joint that the step would move beyond its limit is held
            count = self_motions(J, free, Z)
            steepest = 0.0
            for i in range(count):
                b[i] = 0.0
                for k in range(n):
                    b[i] += Z[i, k] * g[k]
                steepest = max(steepest, abs(b[i]))
            blocked = -1
            if steepest <= _MIN_SLOPE:
                break
            _curvature(p, d, e, kind, square, free, J, Z, count, d2, e2, J2, x, H)
            _ascent_step(H, b, count, L, u)
            longest = 0.0
            for k in range(n):
                x[k] = 0.0
                for i in range(count):
                    x[k] += Z[i, k] * u[i]
                longest = max(longest, abs(x[k]))
                room = limits[k, 1] - q[3 + k] if x[k] > 0.0 else q[3 + k] - limits[k, 0]
                if abs(x[k]) > 1e-14 and room <= _AT_LIMIT:
                    blocked = k
            if blocked >= 0:
                free[blocked] = 0.0
        if steepest <= _MIN_SLOPE:
            break
        share = min(1.0, MAX_STEP / longest)
        done = True  # unless a step gains, and is too long for convergence
        for attempt in range(12):
            if attempt == 1:  # shorten the step to the first limit
                for k in range(n):
                    room = limits[k, 1] - q[3 + k] if x[k] > 0.0 else q[3 + k] - limits[k, 0]
                    if share * abs(x[k]) > room:
                        share = room / abs(x[k])
            for k in range(n):
                trial[3 + k] = min(max(q[3 + k] + share * x[k], limits[k, 0]), limits[k, 1])
                room = min(trial[3 + k] - limits[k, 0], limits[k, 1] - trial[3 + k])
                movable[k] = 1.0 if room > _AT_LIMIT else 0.0
            if move_tip(p, limits, target, trial, d2, e2, J2, free2, movable):
                trial_square = square_measure(p, d2, e2, kind, J2)
                if trial_square > square:
                    done = attempt == 0 and longest < _CONVERGED
                    square = trial_square
                    q[:] = trial
                    d[:], e[:] = d2, e2
                    break
            if attempt > 0:
                share *= 0.25
        if done:
            break
    q_m[:] = q[3:]
    w[0] = math.sqrt(max(square, 0.0))


def climb(
    p: npt.ArrayLike,
    q_m: npt.ArrayLike,
    point: npt.ArrayLike,
    limits: npt.ArrayLike,
    kind: Kind = FIXED,
    steps: int = 100,
) -> tuple[Floats, Floats]:
    """Find a local maximum of w from posture q_m, with the tip at a point of the base's frame.

    First the tip is moved to the point by the least joint motion. Then Newton's method increases w
    along the self-motions of the joints that are not held by a limit. Gradient and curvature of
    w^2 are central differences.

    Args:
        p: parameters of the arm.
        q_m: initial posture.
        point: x, y (..., 2) [m].
        limits: joint limits, which all postures respect.
        kind: kind of measure.
        steps: maximum number of Newton steps; with 0, the tip is only moved to the point.

    Returns:
        The posture (..., n) and its w (...); NaN where the point cannot be reached from q_m.

    Raises:
        ValueError: shapes do not fit.
    """
    q_m = np.asarray(q_m, dtype=float)
    p, _, _ = checked(p, np.concatenate([np.zeros((*q_m.shape[:-1], 3)), q_m], axis=-1))
    return _climb(p, limits, kind, point, q_m, steps)
