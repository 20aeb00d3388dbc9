"""A primal-dual interior-point method for the program of transcription.py.

With s the distance to each limit, lambda its multiplier, J the limits' derivatives and mu the
weight of a barrier -mu sum log s that falls to 0 (Nocedal & Wright 2006, ch. 19), a step solves

    (W + J^T diag(lambda / s) J + delta 1) dx = -(grad f - mu J^T (1 / s)) - nu grad turn

where W is the Gauss-Newton part of the objective's Hessian, delta a damping that grows when steps
must be shortened (Levenberg and Marquardt), and nu such that the turn becomes the requested one.
A segment couples only its two knots and its time, so the matrix is banded, and a step costs
O(m n^3). The method starts strictly within the limits and stays there: each iterate is a feasible
motion. The order of the variables is h_1, knot 1, h_2, knot 2, .., h_K: those of segment k, with a
width of 4 n + 1, start at (k - 1) (2 n + 1) + 1.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.kernels import helper, kernel
from fss_arm_motion.transcription import (
    POINTS,
    WEIGHTS,
    Limited,
    is_constrained,
    make_scratch,
    total_turn,
    write_derivatives,
    write_distances,
)

_BARRIER_FACTOR = 0.4  # factor of the barrier's weight after a good step
_MIN_REMAINDER = 0.02  # least share of its distance to a limit that remains after a step


class Options(NamedTuple):
    """Options of the kernel; see `optimized`."""

    momentum: float
    time_weight: float
    turn_weight: float
    smoothness: float
    turn: float
    least: float
    iterations: float
    tolerance: float
    floor: float


@helper
def _options(o):  # type: ignore[no-untyped-def]
    """Return an array (9,) as Options."""
    return Options(o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7], o[8])


@helper
def _merit(options, mu, h, room, omegas):  # type: ignore[no-untyped-def]
    """Return the objective with the limits' barrier."""
    n, total = room.shape[2] // 4, 0.0
    for k in range(h.size):
        if options.time_weight > 0.0:
            total += options.time_weight * h[k] - mu * math.log(h[k] - options.least)
        for j in range(POINTS):
            total += 0.5 * options.turn_weight * WEIGHTS[j] / h.size * omegas[k, j] ** 2
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, h.size):
                    below, above = room[k, j, r, 0], room[k, j, r, 1]
                    total -= mu * math.log(below * above)
                    if r > 3 * n:
                        total += 0.125 * options.smoothness * (below - above) ** 2
    return total


@helper
def _add(A, g, first, row, weight, slope):  # type: ignore[no-untyped-def]
    """Add weight row row^T to the band A, and slope row to g; row starts at variable `first`."""
    for a in range(max(0, -first), min(row.size, g.size - first)):
        if row[a] == 0.0:
            continue
        g[first + a] += slope * row[a]
        for b in range(max(0, -first), a + 1):
            A[first + a, a - b] += weight * row[a] * row[b]


@helper
def _assemble(options, mu, h, room, dual, dual_h, omegas, rows, A, g, c):  # type: ignore[no-untyped-def]
    """Write the matrix A, the merit's gradient g and the turn's c."""
    n, K, timed = room.shape[2] // 4, h.size, options.time_weight > 0.0
    A[:], g[:], c[:] = 0.0, 0.0, 0.0
    for k in range(K):
        first, at = (k - 1) * (2 * n + 1) + 1, k * (2 * n + 1)
        A[at, 0] += 0.0 if timed else 1.0
        if timed:
            g[at] += options.time_weight - mu / (h[k] - options.least)
            A[at, 0] += dual_h[k] / (h[k] - options.least)
        for j in range(POINTS):
            turn, share = rows[k, j, 4 * n + 1], options.turn_weight * WEIGHTS[j] / K
            c[at] += WEIGHTS[j] * omegas[k, j] if timed else 0.0
            for a in range(max(0, -first), min(turn.size, g.size - first)):
                c[first + a] += h[k] * WEIGHTS[j] * turn[a]
            if share > 0.0:
                _add(A, g, first, turn, share, share * omegas[k, j])
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, K):
                    below, above = room[k, j, r, 0], room[k, j, r, 1]
                    weight = dual[k, j, r, 0] / below + dual[k, j, r, 1] / above
                    slope = mu / above - mu / below
                    if r > 3 * n:  # accelerations, and their part of the objective
                        weight += options.smoothness
                        slope += options.smoothness * 0.5 * (below - above)
                    _add(A, g, first, rows[k, j, r], weight, slope)


@helper
def _factor(A):  # type: ignore[no-untyped-def]
    """Factor a symmetric band by Cholesky, in place: A[i, i - j] has column j of row i."""
    width = A.shape[1]
    for i in range(A.shape[0]):
        for j in range(max(0, i - width + 1), i + 1):
            total = A[i, i - j]
            for k in range(max(0, i - width + 1), j):
                total -= A[i, i - k] * A[j, j - k]
            A[i, i - j] = math.sqrt(max(total, 1e-12)) if i == j else total / A[j, 0]


@helper
def _solve(A, x):  # type: ignore[no-untyped-def]
    """Solve with the factor from _factor, in place."""
    width, size = A.shape[1], A.shape[0]
    for i in range(size):
        for j in range(max(0, i - width + 1), i):
            x[i] -= A[i, i - j] * x[j]
        x[i] /= A[i, 0]
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, min(size, i + width)):
            x[i] -= A[j, j - i] * x[j]
        x[i] /= A[i, 0]


@helper
def _step_variables(least, step, dx, h, q, qd, x_h, x_q, x_qd):  # type: ignore[no-untyped-def]
    """Write the variables after a step to x_h, x_q, x_qd; return False if a time is too short."""
    n = q.shape[1]
    x_q[:], x_qd[:] = q, qd
    for k in range(h.size):
        at = k * (2 * n + 1)
        x_h[k] = h[k] + step * dx[at]
        if not x_h[k] > least:
            return False
        if k + 1 < h.size:
            for i in range(n):
                x_q[k + 1, i] += step * dx[at + 1 + i]
                x_qd[k + 1, i] += step * dx[at + 1 + n + i]
    return True


@helper
def _stays_inside(room, trial):  # type: ignore[no-untyped-def]
    """Return True if each limit keeps a minimum share of its distance."""
    K, n = room.shape[0], room.shape[2] // 4
    for k in range(K):
        for j in range(POINTS):
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, K):
                    own, new = room[k, j, r], trial[k, j, r]
                    if not (new[0] > _MIN_REMAINDER * own[0] and new[1] > _MIN_REMAINDER * own[1]):
                        return False
    return True


@helper
def _dualize(mu, dx, rows, room, trial, dual, toward):  # type: ignore[no-untyped-def]
    """Move the multipliers, by mu / s - lambda - lambda / s ds, and keep them near mu / s."""
    K, n = room.shape[0], room.shape[2] // 4
    reach = 1.0
    for k in range(K):
        first = (k - 1) * (2 * n + 1) + 1
        for j in range(POINTS):
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, K):
                    moves, row = 0.0, rows[k, j, r]
                    for a in range(max(0, -first), min(row.size, dx.size - first)):
                        moves += row[a] * dx[first + a]
                    for side in range(2):
                        s, own = room[k, j, r, side], dual[k, j, r, side]
                        ds = moves if side == 0 else -moves
                        toward[k, j, r, side] = change = mu / s - own - own / s * ds
                        if change < -0.98 * reach * own:
                            reach = -0.98 * own / change
    for k in range(K):
        for j in range(POINTS):
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, K):
                    for side in range(2):
                        central = mu / trial[k, j, r, side]
                        new = dual[k, j, r, side] + reach * toward[k, j, r, side]
                        dual[k, j, r, side] = min(max(new, 1e-3 * central), 1e3 * central)


@helper
def _complementarity(h, least, timed, room, dual, dual_h):  # type: ignore[no-untyped-def]
    """Return the sum of s lambda, and the number of terms."""
    K, n = room.shape[0], room.shape[2] // 4
    gap, count = 0.0, 0
    for k in range(K):
        if timed:
            gap += dual_h[k] * (h[k] - least)
            count += 1
        for j in range(POINTS):
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, K):
                    for side in range(2):
                        gap += dual[k, j, r, side] * room[k, j, r, side]
                        count += 1
    return gap, count


@kernel("(p),(n,b),(n,l),(r),(u),(o),(s),(m,n),(m,n),(i)->(s),(m,n),(m,n),(i)")
def _optimize(  # type: ignore[no-untyped-def]
    p, bounds, limits, rotor, radii, options_, h0, q0, qd0, _i, h_out, q_out, qd_out, report
):
    # Helpers get contiguous arrays: numba takes long to compile them for other arrays.
    options = _options(options_)
    arm = Limited(
        p.copy(), rotor.copy(), options.momentum, bounds.copy(), limits.copy(), radii.copy()
    )
    h, q, qd = h0.copy(), q0.copy(), qd0.copy()
    n, K = bounds.shape[0], h.size
    size, wide = (K - 1) * (2 * n + 1) + 1, 4 * n + 1
    goal, least, tolerance = options.turn, options.least, options.tolerance
    most, turning, timed = int(options.iterations), not math.isnan(goal), options.time_weight > 0.0
    scratch = make_scratch(n)
    room, trial, dual, toward = np.zeros((4, K, POINTS, wide, 2))
    omegas, x_omegas = np.empty((2, K, POINTS))
    rows = np.empty((K, POINTS, wide + 1, wide))
    A, (g, c, dx, z) = np.empty((size, wide)), np.empty((4, size))
    x_h, x_q, x_qd, dual_h = np.empty(K), np.empty_like(q), np.empty_like(q), np.empty(K)
    report[:] = 0.0
    if not write_distances(arm, scratch, h, q, qd, room, omegas) > 0.0:
        report[0], most = -1.0, 0
    gap, count = _complementarity(h, least, timed, room, dual, dual_h)
    time, mark = h.sum(), math.inf  # mark: the cost some iterations ago
    marked, damping, penalty, residual = 0, 1e-9, 0.0, 0.0
    mu = 0.1 * time / count
    for k in range(K):
        dual_h[k] = mu / max(h[k] - least, 1e-9)
        for j in range(POINTS):
            for r in range(wide):
                for side in range(2):
                    dual[k, j, r, side] = mu / max(room[k, j, r, side], 1e-9)
    for iteration in range(most):
        report[0] = iteration + 1.0
        for k in range(K):
            for j in range(POINTS):
                write_derivatives(
                    arm, scratch, j, h[k], q[k : k + 2], qd[k : k + 2], timed, rows[k, j]
                )
        _assemble(options, mu, h, room, dual, dual_h, omegas, rows, A, g, c)
        A[:, 0] += damping
        _factor(A)
        dx[:] = -g
        _solve(A, dx)
        lack = 0.0
        if turning:
            z[:] = c
            _solve(A, z)
            lack = total_turn(h, omegas) - goal
            price = (lack + (c * dx).sum()) / max((c * z).sum(), 1e-300)
            dx -= price * z
            penalty = max(penalty, 1.5 * abs(price))
        slope = (g * dx).sum() - penalty * abs(lack)
        before = _merit(options, mu, h, room, omegas) + penalty * abs(lack)
        step, good = 1.0, False
        for _ in range(30):
            good = _step_variables(least if timed else 0.0, step, dx, h, q, qd, x_h, x_q, x_qd)
            if good:
                write_distances(arm, scratch, x_h, x_q, x_qd, trial, x_omegas)
                good = _stays_inside(room, trial)
            if good:
                after = _merit(options, mu, x_h, trial, x_omegas)
                after += penalty * abs(total_turn(x_h, x_omegas) - goal) if turning else 0.0
                good = after <= before + 1e-4 * step * slope + 1e-10
            if good:
                break
            step *= 0.6
        if not good:
            break
        _dualize(mu, dx, rows, room, trial, dual, toward)
        h[:], q[:], qd[:], room[:], omegas[:] = x_h, x_q, x_qd, trial, x_omegas
        if timed:
            dual_h[:] = mu / (h - least)
        gap, _ = _complementarity(h, least, timed, room, dual, dual_h)
        time, residual = h.sum(), abs(total_turn(h, omegas) - goal) if turning else 0.0
        report[1], report[2] = gap, residual
        # Little complementarity is left, and the cost no longer improves.
        if residual < 1e-5 and time < (1.0 + tolerance) * options.floor:
            break
        if iteration >= marked + 4:
            cost = time if timed else (omegas * omegas).sum()
            slow = cost > (1.0 - (tolerance if timed else 0.02)) * mark
            if slow and residual < 1e-5 and gap < 5.0 * tolerance * time:
                break
            mark, marked = cost, iteration
        if step > 0.7:
            damping, mu = max(0.2 * damping, 1e-9), _BARRIER_FACTOR * gap / count
        elif step < 0.3:
            damping, mu = max(4.0 * damping, 1e-3), gap / count
        else:
            mu = 0.7 * gap / count
    h_out[:], q_out[:], qd_out[:] = h, q, qd
    report[3] = mu


def optimized(
    p: npt.ArrayLike,
    bounds: npt.ArrayLike,
    limits: npt.ArrayLike,
    rotor: npt.ArrayLike,
    radii: npt.ArrayLike,
    h: npt.ArrayLike,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    *,
    momentum: float = 0.0,
    time_weight: float = 1.0,
    turn_weight: float = 0.0,
    smoothness: float = 1e-4,
    turn: float = math.nan,
    least: float = 0.0,
    iterations: float = 60,
    tolerance: float = 1e-3,
    floor: float = 0.0,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the best motion near an initial one that is strictly within the limits.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        bounds: (n, 2) lowest and highest joint readings [rad].
        limits: (n, 4) of rates, accelerations and torques, and viscous friction, in SI units.
        rotor: (2,) N^2 J and N J [kg m^2].
        radii: (3,) of the base and of links, and the margin between bodies [m].
        h: (..., m - 1) times between knots [s].
        q: (..., m, n) angles at the knots [rad]; the first and the last are fixed.
        qd: (..., m, n) rates; 0 at the first and the last [rad/s].
        momentum: L [N m s].
        time_weight: w_t; 0: the times are fixed.
        turn_weight: w_r [s^2].
        smoothness: w_s [s^4].
        turn: turn of the base [rad]; NaN: any.
        least: least time between knots [s].
        iterations: largest number of iterations.
        tolerance: tolerance of the time, as a share.
        floor: lower bound of the time of any motion [s].

    Returns:
        h, q and qd, and (..., 4): number of iterations, -1 if the initial motion is not within the
        limits; complementarity left [s]; residual of the turn [rad]; the barrier's weight.
    """
    options = Options(
        momentum, time_weight, turn_weight, smoothness, turn, least, iterations, tolerance, floor
    )
    asked = p, bounds, limits, rotor, radii, np.array(options), h, q, qd
    # Vectorized code also divides by entries that are not limited; their results are not used.
    with np.errstate(divide="ignore", invalid="ignore"):
        found = _optimize(*asked, np.empty(4))
    return found[0], found[1], found[2], found[3]
