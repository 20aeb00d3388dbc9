"""The best motion between two postures within limits: a nonlinear program over few knots.

A path has m knots, at rest at the first and the last one, and cubics between them (Hermite's), as
the links keep it. The inner knots' angles and rates and the times h_k between knots are chosen:

    minimize    w_t sum_k h_k + w_r mean(omega^2) / 2 + w_s sum(q''^2) / 2
    subject to  |q'| <= rate, |q''| <= acceleration, q_min <= q <= q_max, h_k >= least,
                |tau + viscous q'| <= torque, gap >= margin, and, if asked for, int omega dt = turn

where omega is the base's rate, tau the torques of free_floating.py and gap the least one between
two bodies that are not neighbours (fss_arm_model.clearance). They are asked for at the
four Lobatto points of each segment; what happens between them is for the caller to see. As
accelerations may jump at knots whose times are free, few knots suffice where the best motion
switches between limits.

The solver is a primal-dual interior-point method (Nocedal & Wright 2006, ch. 19) with Gauss and
Newton's Hessian. A segment couples its two knots and its time alone, so that the matrix is banded,
and a step costs O(m n^3). It begins strictly within the limits and stays there: each iterate is a
motion that can be made.
"""

import math

import numpy as np
import numpy.typing as npt

from fss_arm_model.clearance import _apart, _to_segment
from fss_arm_model.free_floating import _free_torques
from fss_arm_model.kernels import Floats, helper, kernel
from fss_arm_model.kinematics import _chain

_POINTS = np.array([0.0, 0.5 - 0.5 / math.sqrt(5.0), 0.5 + 0.5 / math.sqrt(5.0), 1.0])
_WEIGHTS = np.array([1.0, 5.0, 5.0, 1.0]) / 12.0
_DIFFERENCE = 1e-6  # of angles and rates, for forward differences

SIGMA = 0.4  # by which the barrier falls after a good step
_FAR = 1e3  # gap of an arm that has no two bodies that may touch, and more than any [m]

# What is limited, of each joint; and GAP, of the arm, as if a joint more had a torque.
TORQUE, RATE, POSITION, ACCELERATION = range(4)


def _basis() -> Floats:
    """Weights of q_0, h q'_0, q_1, h q'_1 in q, h q' and h^2 q'' at each point, (4, 3, 4)."""
    x = _POINTS
    value = [1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2]
    rate = [6 * x**2 - 6 * x, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x]
    gain = [12 * x - 6, 6 * x - 4, 6 - 12 * x, 6 * x - 2]
    return np.moveaxis(np.array([value, rate, gain]), 2, 0).copy()


_BASIS = _basis()


@helper
def _at(point, h, q, qd, state, rate, gain):  # type: ignore[no-untyped-def]
    """Write the joints' part of state, rate and gain at a point of a segment with knots (2, n)."""
    b = _BASIS[point]
    for i in range(q.shape[1]):
        q0, q1, v0, v1 = q[0, i], q[1, i], h * qd[0, i], h * qd[1, i]
        state[3 + i] = b[0, 0] * q0 + b[0, 1] * v0 + b[0, 2] * q1 + b[0, 3] * v1
        rate[3 + i] = (b[1, 0] * q0 + b[1, 1] * v0 + b[1, 2] * q1 + b[1, 3] * v1) / h
        gain[3 + i] = (b[2, 0] * q0 + b[2, 1] * v0 + b[2, 2] * q1 + b[2, 3] * v1) / (h * h)


@helper
def _by_variables(point, order, h, q, qd, i, out):  # type: ignore[no-untyped-def]
    """Write the derivatives of joint i's q, q' or q'' by q_0, q'_0, h, q_1, q'_1: out (5,)."""
    b = _BASIS[point, order]
    scale = h ** (-order)
    out[0], out[1], out[3], out[4] = b[0] * scale, b[1] * scale * h, b[2] * scale, b[3] * scale * h
    angles, rates = b[0] * q[0, i] + b[2] * q[1, i], b[1] * qd[0, i] + b[3] * qd[1, i]
    out[2] = -order * angles * scale / h + (1 - order) * rates * scale


@helper
def _nearest(p, state, radii, work):  # type: ignore[no-untyped-def]
    """The least gap between two bodies that are not neighbours, the base at the origin."""
    d = work[0]
    _chain(p, state, d, work[1])
    least, a = _FAR - 1.0, d[0]
    for i in range(2, d.size):
        a += d[i - 1]  # where link i begins
        least = min(least, _to_segment(a, d[i], 0j) - radii[0] - radii[1])
        b = d[0]
        for j in range(1, i - 1):
            least = min(least, _apart(a, d[i], b, d[j]) - 2.0 * radii[1])
            b += d[j]
    return least


@helper
def _is_asked(kind, i, n, k, point, segments):  # type: ignore[no-untyped-def]
    """Whether a limit is one at this point: accelerations are largest at a segment's ends."""
    if i == n and kind != TORQUE:
        return False
    if kind == ACCELERATION:
        return point == 0 or point == 3
    if kind == POSITION or i == n:
        return not ((k == 0 and point == 0) or (k == segments - 1 and point == 3))
    return True


@helper
def _values(  # type: ignore[no-untyped-def]
    p, rotor, L, bounds, limits, radii, h, q, qd, state, rate, gain, work, second, tau, room, omegas,
):  # fmt: skip
    """Write the room (K, 4, 4, n + 1, 2) below and above within each limit, and the base's rates (K, 4).

    Returns the least room.
    """
    n, least = bounds.shape[0], math.inf
    for k in range(h.size):
        for j in range(4):
            _at(j, h[k], q[k : k + 2], qd[k : k + 2], state, rate, gain)
            omegas[k, j] = _free_torques(p, rotor, L, state, rate, gain, work, second, tau)
            room[k, j, :, n] = _FAR
            room[k, j, TORQUE, n, 0] = _nearest(p, state, radii, work) - radii[2]
            if _is_asked(TORQUE, n, n, k, j, h.size):
                least = min(least, room[k, j, TORQUE, n, 0])
            for i in range(n):
                own = room[k, j, :, i]
                load = tau[3 + i] + limits[i, 3] * rate[3 + i]
                own[TORQUE, 0], own[TORQUE, 1] = load + limits[i, 2], limits[i, 2] - load
                own[RATE, 0] = rate[3 + i] + limits[i, 0]
                own[RATE, 1] = limits[i, 0] - rate[3 + i]
                own[POSITION, 0] = state[3 + i] - bounds[i, 0]
                own[POSITION, 1] = bounds[i, 1] - state[3 + i]
                own[ACCELERATION, 0] = gain[3 + i] + limits[i, 1]
                own[ACCELERATION, 1] = limits[i, 1] - gain[3 + i]
                for kind in range(4):
                    if _is_asked(kind, i, n, k, j, h.size):
                        least = min(least, own[kind, 0], own[kind, 1])
    return least


@helper
def _turn(h, omegas):  # type: ignore[no-untyped-def]
    """The integral of the base's rate."""
    total = 0.0
    for k in range(h.size):
        for j in range(4):
            total += h[k] * _WEIGHTS[j] * omegas[k, j]
    return total


@helper
def _merit(weights, mu, least, h, q, qd, room, omegas):  # type: ignore[no-untyped-def]
    """The objective with the limits' barrier."""
    n, total = q.shape[1], 0.0
    for k in range(h.size):
        total += weights[0] * h[k]
        if weights[0] > 0.0:
            total -= mu * math.log(h[k] - least)
        for j in range(4):
            total += 0.5 * weights[1] * _WEIGHTS[j] / h.size * omegas[k, j] ** 2
            for i in range(n + 1):
                for kind in range(4):
                    if _is_asked(kind, i, n, k, j, h.size):
                        total -= mu * math.log(room[k, j, kind, i, 0] * room[k, j, kind, i, 1])
        for j in range(0, 4, 3):
            b = _BASIS[j, 2]
            for i in range(n):
                a = (b[0] * q[k, i] + b[2] * q[k + 1, i]) / (h[k] * h[k])
                a += (b[1] * qd[k, i] + b[3] * qd[k + 1, i]) / h[k]
                total += 0.5 * weights[2] * a * a
    return total


@helper
def _torque_rows(  # type: ignore[no-untyped-def]
    p, rotor, L, limits, radii, point, h, q, qd, state, rate, gain, work, second, tau, other, rows,
    part,
):  # fmt: skip
    """Write the derivatives of torques, gap and base's rate by a segment's variables.

    rows is (n + 2, 4 n + 1).

    A segment's variables are q_0, q'_0, h, q_1, q'_1.
    """
    n = q.shape[1]
    _at(point, h, q, qd, state, rate, gain)
    omega = _free_torques(p, rotor, L, state, rate, gain, work, second, tau)
    gap, near = _nearest(p, state, radii, work), 0.0
    rows[:] = 0.0
    for i in range(n):
        for order in range(3):
            # by the angle, rate or acceleration of joint i
            if order == 0:
                state[3 + i] += _DIFFERENCE
                ahead = _free_torques(p, rotor, L, state, rate, gain, work, second, other)
                near = _nearest(p, state, radii, work) - gap
                state[3 + i] -= _DIFFERENCE
            elif order == 1:
                rate[3 + i] += _DIFFERENCE
                ahead = _free_torques(p, rotor, L, state, rate, gain, work, second, other)
                rate[3 + i] -= _DIFFERENCE
            else:
                gain[3 + i] += 1.0  # linear
                ahead = _free_torques(p, rotor, L, state, rate, gain, work, second, other)
                gain[3 + i] -= 1.0
            size = _DIFFERENCE if order < 2 else 1.0
            _by_variables(point, order, h, q, qd, i, part)
            for r in range(n + 2):
                if r < n:
                    slope = (other[3 + r] - tau[3 + r]) / size
                    if r == i and order == 1:
                        slope += limits[i, 3]
                elif r == n:
                    slope = near / size if order == 0 else 0.0
                else:
                    slope = (ahead - omega) / size
                rows[r, i] += slope * part[0]
                rows[r, n + i] += slope * part[1]
                rows[r, 2 * n] += slope * part[2]
                rows[r, 2 * n + 1 + i] += slope * part[3]
                rows[r, 3 * n + 1 + i] += slope * part[4]


@helper
def _add(A, g, first, row, weight, slope):  # type: ignore[no-untyped-def]
    """Add weight row row^T to the band A, and slope row to g; row begins at variable `first`."""
    for a in range(max(0, -first), min(row.size, g.size - first)):
        if row[a] == 0.0:
            continue
        g[first + a] += slope * row[a]
        for b in range(max(0, -first), a + 1):
            A[first + a, a - b] += weight * row[a] * row[b]


@helper
def _factor(A):  # type: ignore[no-untyped-def]
    """Cholesky's L of a symmetric band, A[i, i - j] holding column j of row i; in place."""
    width = A.shape[1]
    for i in range(A.shape[0]):
        for j in range(max(0, i - width + 1), i + 1):
            total = A[i, i - j]
            for k in range(max(0, i - width + 1), j):
                total -= A[i, i - k] * A[j, j - k]
            if i == j:
                A[i, 0] = math.sqrt(max(total, 1e-12))
            else:
                A[i, i - j] = total / A[j, 0]


@helper
def _solve(A, x):  # type: ignore[no-untyped-def]
    """Solve with what _factor made, in place."""
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
def _moved(x, step, dx, h, q, qd, x_h, x_q, x_qd):  # type: ignore[no-untyped-def]
    """Write x_h, x_q, x_qd: the variables a step on; False if a time is too short."""
    n = q.shape[1]
    x_q[:], x_qd[:] = q, qd
    for k in range(h.size):
        at = k * (2 * n + 1)
        x_h[k] = h[k] + step * dx[at]
        if not x_h[k] > x:
            return False
        if k + 1 < h.size:
            for i in range(n):
                x_q[k + 1, i] += step * dx[at + 1 + i]
                x_qd[k + 1, i] += step * dx[at + 1 + n + i]
    return True


@kernel("(p),(n,b),(n,l),(r),(u),(o),(s),(m,n),(m,n),(i)->(s),(m,n),(m,n),(i)")
def _optimized(  # type: ignore[no-untyped-def]
    p_, bounds_, limits_, rotor_, radii_, options, h0, q0, qd0, _i, h_out, q_out, qd_out, report,
):  # fmt: skip
    # What is called much is given contiguous arrays: numba takes long to compile it for other ones.
    p, bounds, limits, rotor = p_.copy(), bounds_.copy(), limits_.copy(), rotor_.copy()
    h, q, qd, radii = h0.copy(), q0.copy(), qd0.copy(), radii_.copy()
    h_out[:], q_out[:], qd_out[:] = h, q, qd
    n, K = bounds.shape[0], h0.size
    size, wide = (K - 1) * (2 * n + 1) + 1, 4 * n + 1
    L, weights, goal = options[0], options[1:4].copy(), options[4]
    least, most, tolerance, floor = options[5], int(options[6]), options[7], options[8]
    turning, timed = not math.isnan(goal), weights[0] > 0.0
    state, rate, gain, tau, other = np.empty((5, 3 + n))
    work, second = np.empty((3, n + 1), np.complex128), np.empty((2, n + 1), np.complex128)
    room, dual, toward = np.empty((3, K, 4, 4, n + 1, 2))
    trial = np.empty((K, 4, 4, n + 1, 2))
    omegas, x_omegas = np.empty((2, K, 4))
    kept = np.empty((K, 4, n + 2, wide))  # rows of torques, gap and base's rate
    A, g, dx, c, z = np.empty((size, wide)), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    row, part, dual_h = np.empty(wide), np.empty(5), np.empty(K)
    x_h, x_q, x_qd = np.empty(K), np.empty_like(q), np.empty_like(q)
    report[:] = 0.0
    lowest = _values(
        p, rotor, L, bounds, limits, radii, h, q, qd, state, rate, gain, work, second, tau, room,
        omegas,
    )  # fmt: skip
    if not lowest > 0.0:
        report[0] = -1.0
        return
    count = 0
    for k in range(K):
        for j in range(4):
            for kind in range(4):
                for i in range(n + 1):
                    count += 2 * int(_is_asked(kind, i, n, k, j, K))
    count += K * int(timed)
    total_time = 0.0
    for k in range(K):
        total_time += h[k]
    mu, penalty, residual = 0.1 * total_time / count, 0.0, 0.0
    damping = 1e-9
    mark, marked = total_time, 0  # the time some iterations ago
    for k in range(K):
        dual_h[k] = mu / max(h[k] - least, 1e-9)
        for j in range(4):
            for kind in range(4):
                for i in range(n + 1):
                    for side in range(2):
                        dual[k, j, kind, i, side] = 0.0
                        if _is_asked(kind, i, n, k, j, K):
                            dual[k, j, kind, i, side] = mu / room[k, j, kind, i, side]
    for iteration in range(most):
        report[0] = iteration + 1.0
        A[:], g[:], c[:] = 0.0, 0.0, 0.0
        for k in range(K):
            first, at = (k - 1) * (2 * n + 1) + 1, k * (2 * n + 1)
            if timed:
                slack = h[k] - least
                g[at] += weights[0] - mu / slack
                A[at, 0] += dual_h[k] / slack
            else:
                A[at, 0] += 1.0
            for j in range(4):
                rows = kept[k, j]
                _torque_rows(
                    p, rotor, L, limits, radii, j, h[k], q[k : k + 2], qd[k : k + 2], state, rate, gain, work, second, tau, other, rows, part,
                )  # fmt: skip
                if not timed:
                    rows[:, 2 * n] = 0.0
                for a in range(max(0, -first), min(wide, size - first)):
                    c[first + a] += h[k] * _WEIGHTS[j] * rows[n + 1, a]
                if timed:
                    c[at] += _WEIGHTS[j] * omegas[k, j]
                share = weights[1] * _WEIGHTS[j] / K
                if share > 0.0:
                    _add(A, g, first, rows[n + 1], share, share * omegas[k, j])
                for i in range(n + 1):
                    for kind in range(4):
                        if not _is_asked(kind, i, n, k, j, K):
                            continue
                        below, above = room[k, j, kind, i, 0], room[k, j, kind, i, 1]
                        weight = dual[k, j, kind, i, 0] / below + dual[k, j, kind, i, 1] / above
                        slope = mu / above - mu / below
                        if kind == TORQUE:
                            _add(A, g, first, rows[i], weight, slope)
                            continue
                        order = 1 if kind == RATE else (0 if kind == POSITION else 2)
                        _by_variables(j, order, h[k], q[k : k + 2], qd[k : k + 2], i, part)
                        row[:] = 0.0
                        row[i], row[n + i] = part[0], part[1]
                        row[2 * n] = part[2] if timed else 0.0
                        row[2 * n + 1 + i], row[3 * n + 1 + i] = part[3], part[4]
                        if kind == ACCELERATION:
                            weight += weights[2]
                            slope += weights[2] * 0.5 * (below - above)
                        _add(A, g, first, row, weight, slope)
        A[:, 0] += damping
        _factor(A)
        dx[:] = -g
        _solve(A, dx)
        lack = 0.0
        if turning:
            z[:] = c
            _solve(A, z)
            lack = _turn(h, omegas) - goal
            by, at_step = 0.0, lack
            for a in range(size):
                by += c[a] * z[a]
                at_step += c[a] * dx[a]
            price = at_step / max(by, 1e-300)
            for a in range(size):
                dx[a] -= price * z[a]
            penalty = max(penalty, 1.5 * abs(price))
        slope = -penalty * abs(lack)
        for a in range(size):
            slope += g[a] * dx[a]
        before = _merit(weights, mu, least, h, q, qd, room, omegas) + penalty * abs(lack)
        step, good = 1.0, False
        for _ in range(30):
            good = _moved(least if timed else 0.0, step, dx, h, q, qd, x_h, x_q, x_qd)
            if good:
                _values(
                    p, rotor, L, bounds, limits, radii, x_h, x_q, x_qd, state, rate, gain, work,
                    second, tau, trial, x_omegas,
                )  # fmt: skip
                for k in range(K):
                    for j in range(4):
                        for kind in range(4):
                            for i in range(n + 1):
                                if _is_asked(kind, i, n, k, j, K):
                                    now, new = room[k, j, kind, i], trial[k, j, kind, i]
                                    good &= new[0] > 0.02 * now[0] and new[1] > 0.02 * now[1]
            if good:
                after = _merit(weights, mu, least, x_h, x_q, x_qd, trial, x_omegas)
                after += penalty * abs(_turn(x_h, x_omegas) - goal) if turning else 0.0
                good = after <= before + 1e-4 * step * slope + 1e-10
            if good:
                break
            step *= 0.6
        if not good:
            break
        # Duals: mu / s - lambda - lambda / s ds, no more than to a fiftieth of what they were.
        reach = 1.0
        for turn in range(2):
            for k in range(K):
                first = (k - 1) * (2 * n + 1) + 1
                for j in range(4):
                    for i in range(n + 1):
                        for kind in range(4):
                            if not _is_asked(kind, i, n, k, j, K):
                                continue
                            if turn == 0:
                                moves = 0.0
                                if kind == TORQUE:
                                    for a in range(max(0, -first), min(wide, size - first)):
                                        moves += kept[k, j, i, a] * dx[first + a]
                                else:
                                    order = 1 if kind == RATE else (0 if kind == POSITION else 2)
                                    _by_variables(
                                        j, order, h[k], q[k : k + 2], qd[k : k + 2], i, part
                                    )
                                    if k > 0:
                                        moves += part[0] * dx[first + i] + part[1] * dx[first + n + i]
                                    if timed:
                                        moves += part[2] * dx[first + 2 * n]
                                    if k + 1 < K:
                                        moves += part[3] * dx[first + 2 * n + 1 + i]
                                        moves += part[4] * dx[first + 3 * n + 1 + i]
                                for side in range(2):
                                    s, own = room[k, j, kind, i, side], dual[k, j, kind, i, side]
                                    ds = moves if side == 0 else -moves
                                    change = mu / s - own - own / s * ds
                                    toward[k, j, kind, i, side] = change
                                    if change < -0.98 * reach * own:
                                        reach = min(reach, -0.98 * own / change)
                            else:
                                for side in range(2):
                                    s = trial[k, j, kind, i, side]
                                    own = dual[k, j, kind, i, side] + reach * toward[k, j, kind, i, side]
                                    dual[k, j, kind, i, side] = min(max(own, 1e-3 * mu / s), 1e3 * mu / s)
        if timed:
            for k in range(K):
                s = x_h[k] - least
                dual_h[k] = mu / s
        h[:], q[:], qd[:] = x_h, x_q, x_qd
        room[:] = trial
        omegas[:] = x_omegas
        gap, total_time = 0.0, 0.0
        for k in range(K):
            total_time += h[k]
            if timed:
                gap += dual_h[k] * (h[k] - least)
            for j in range(4):
                for kind in range(4):
                    for i in range(n + 1):
                        if _is_asked(kind, i, n, k, j, K):
                            for side in range(2):
                                gap += dual[k, j, kind, i, side] * room[k, j, kind, i, side]
        residual = abs(_turn(h, omegas) - goal) if turning else 0.0
        report[1], report[2] = gap, residual
        # Little complementarity is left, and it gets no faster.
        if residual < 1e-5 and total_time < (1.0 + tolerance) * floor:
            break
        if iteration >= marked + 4:
            slow = not timed or total_time > (1.0 - tolerance) * mark
            if slow and residual < 1e-5 and gap < 5.0 * tolerance * total_time:
                break
            mark, marked = total_time, iteration
        if step > 0.7:
            damping = max(0.2 * damping, 1e-9)
            mu = SIGMA * gap / count
        elif step < 0.3:
            damping = max(4.0 * damping, 1e-3)
            mu = gap / count
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
    iterations: int = 60,
    tolerance: float = 1e-3,
    floor: float = 0.0,
) -> tuple[Floats, Floats, Floats, Floats]:
    """The best motion near a first one that keeps strictly within the limits.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        bounds: (n, 2) lowest and highest joint readings [rad].
        limits: (n, 4) of rates, accelerations and torques, and viscous friction, in SI units.
        rotor: (2,) N^2 J and N J [kg m^2].
        radii: (3,) of the base and of links, and the margin between bodies [m].
        h: (..., m - 1) times between knots [s].
        q: (..., m, n) angles at the knots [rad]; the first and the last stay.
        qd: (..., m, n) rates; 0 at the first and the last [rad/s].
        momentum: L [N m s].
        time_weight: w_t; 0: the times stay.
        turn_weight: w_r [s^2].
        smoothness: w_s [s^4].
        turn: of the base [rad]; NaN: any.
        least: time between knots [s].
        iterations: at most.
        tolerance: of the time, as a share.
        floor: a time that no motion can be shorter than [s].

    Returns:
        h, q and qd, and (..., 4): iterations made, -1 if the first motion is not within the
        limits; complementarity gap left [s]; residual of the turn [rad]; the barrier's weight.
    """
    options = [
        momentum, time_weight, turn_weight, smoothness, turn, least, iterations, tolerance, floor,
    ]  # fmt: skip
    found = _optimized(p, bounds, limits, rotor, radii, np.array(options), h, q, qd, np.empty(4))
    return found[0], found[1], found[2], found[3]
