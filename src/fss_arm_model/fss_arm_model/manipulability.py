"""The posture in which the arm moves its tip best while it is at a given point.

    w = sqrt(det(J J^T))                                              (Yoshikawa 1985)

J are the first r rows, r = 2 (position) or 3 (pose), of the tip's Jacobian J_m if the base is held
and of the generalized Jacobian J* if it floats. w does not depend on the base's own pose.

Arguments everywhere: p (..., 8 + 6 n) is Arm.vector(), q_m (..., n) the joint readings [rad],
limits (..., n, 2) the lowest and highest of them, kind (2,) what is measured: whether the base
floats (1 or 0), and r. Leading dimensions broadcast.

In the kernels, q is a state whose base lies at the origin; d and e are its bodies' vectors as in
kinematics.py. Beside a state, at joints moved by small angles x (n,), these are only turned, and
no trigonometric function is needed.
"""

import math

import numpy as np
import numpy.typing as npt

from ._cache import Complexes, Floats, helper, kernel
from .kinematics import _chain, _dot, checked
from .momentum import _floating

__all__ = ["FIXED", "FIXED_POSE", "FLOATING", "FLOATING_POSE", "climb"]

# What is measured.
FIXED, FLOATING = np.array([0.0, 2.0]), np.array([1.0, 2.0])
FIXED_POSE, FLOATING_POSE = np.array([0.0, 3.0]), np.array([1.0, 3.0])

_CLOSED = 1e-12  # distance from the target that counts as none [m]
_AT_LIMIT = 1e-7  # distance from a limit that counts as none [rad]
_LONGEST = 0.3  # step of a joint [rad]
_SHORT = 1e-3  # step after which Newton's method leaves next to nothing [rad]
_FLAT = 1e-8  # slope of w^2 that counts as none [m^4/rad]


@helper
def _held(d: Complexes, J: Floats) -> complex:
    """Write J_m (3, n); return the tip's position from the base's."""
    arm = 0j
    for k in range(d.size - 1, 0, -1):
        arm += d[k]
        J[0, k - 1], J[1, k - 1], J[2, k - 1] = -arm.imag, arm.real, 1.0
    return arm + d[0]


@helper
def _square(p: Floats, d: Complexes, e: Complexes, kind: Floats, J: Floats) -> float:
    """w^2 = det(J J^T), J being scratch (3, n)."""
    if kind[0] > 0.0:
        _floating(p, d, e, J)
    else:
        _held(d, J)
    xx = xy = yy = xz = yz = zz = 0.0
    for k in range(J.shape[1]):
        x, y, z = J[0, k], J[1, k], J[2, k]
        xx += x * x
        xy += x * y
        yy += y * y
        xz += x * z
        yz += y * z
        zz += z * z
    plane = xx * yy - xy * xy
    if kind[1] < 3.0:
        return plane
    return zz * plane - xz * (xz * yy - xy * yz) - yz * (yz * xx - xy * xz)


@helper
def _fit(J: Floats, free: Floats, x: float, y: float) -> complex:
    """(J J^T)^-1 (x, y), J being two rows of the free joints; zero if they lack a direction."""
    xx = xy = yy = 0.0
    for k in range(free.size):
        xx += free[k] * J[0, k] * J[0, k]
        xy += free[k] * J[0, k] * J[1, k]
        yy += free[k] * J[1, k] * J[1, k]
    det = xx * yy - xy * xy
    if not det > 1e-12 * (xx + yy) * (xx + yy):
        return 0j
    return complex(yy * x - xy * y, xx * y - xy * x) / det


@helper
def _close(
    p: Floats,
    limits: Floats,
    target: complex,
    q: Floats,
    d: Complexes,
    e: Complexes,
    J: Floats,
    free: Floats,
    may: Floats,
) -> bool:
    """Bring the tip to the target by least motion within the limits, d and e too; False if in vain.

    Only joints with 1 in `may` (n,) move; J (3, n) and free (n,) are scratch.
    """
    for _ in range(30):
        _chain(p, q, d, e)
        error = target - _held(d, J)
        if _dot(error, error) < _CLOSED * _CLOSED:
            return True
        free[:] = may
        longest, stopped = 0.0, True
        while stopped:  # joints that would leave their limits stay
            y = _fit(J, free, error.real, error.imag)
            if y == 0j:
                return False
            longest, stopped = 0.0, False
            for k in range(free.size):
                move = free[k] * _dot(complex(J[0, k], J[1, k]), y)
                longest = max(longest, abs(move))
                room = limits[k, 1] - q[3 + k] if move > 0.0 else q[3 + k] - limits[k, 0]
                if move != 0.0 and room <= 0.0:
                    free[k], stopped = 0.0, True
        y *= min(1.0, _LONGEST / longest)
        for k in range(free.size):
            move = free[k] * _dot(complex(J[0, k], J[1, k]), y)
            q[3 + k] = min(max(q[3 + k] + move, limits[k, 0]), limits[k, 1])
    return False


@helper
def _turned(
    d: Complexes, e: Complexes, x: Floats, sign: float, d2: Complexes, e2: Complexes
) -> None:
    """Write d2 and e2: d and e with the joints moved by the small angles sign x (n,)."""
    d2[0], e2[0] = d[0], e[0]
    angle = 0.0
    for k in range(x.size):
        angle += sign * x[k]
        s = angle * angle
        turn = complex(1.0 - 0.5 * s + s * s / 24.0, angle * (1.0 - s / 6.0 + s * s / 120.0))
        d2[k + 1], e2[k + 1] = d[k + 1] * turn, e[k + 1] * turn


@helper
def _gradient(
    p: Floats,
    d: Complexes,
    e: Complexes,
    kind: Floats,
    d2: Complexes,
    e2: Complexes,
    J: Floats,
    x: Floats,
    g: Floats,
) -> None:
    """Write the derivative of w^2 by the joints, g (n,), by central differences."""
    step = 1e-5
    x[:] = 0.0
    for k in range(g.size):
        x[k] = step
        _turned(d, e, x, 1.0, d2, e2)
        ahead = _square(p, d2, e2, kind, J)
        _turned(d, e, x, -1.0, d2, e2)
        g[k] = (ahead - _square(p, d2, e2, kind, J)) / (2.0 * step)
        x[k] = 0.0


@helper
def _let_go(limits: Floats, q: Floats, J: Floats, g: Floats, free: Floats) -> None:
    """Write which joints are free (n,): those within their limits, and those that gain by leaving.

    With the multipliers y of the free joints, J^T y = g, joint k gains g_k - J_k . y a radian.
    """
    for k in range(free.size):
        room = min(q[3 + k] - limits[k, 0], limits[k, 1] - q[3 + k])
        free[k] = 1.0 if room > _AT_LIMIT else 0.0
    for _ in range(free.size):
        a = b = 0.0
        for k in range(free.size):
            a += free[k] * J[0, k] * g[k]
            b += free[k] * J[1, k] * g[k]
        y = _fit(J, free, a, b)
        chosen, most = -1, _FLAT
        for k in range(free.size):
            gain = g[k] - _dot(complex(J[0, k], J[1, k]), y)
            if limits[k, 1] - q[3 + k] <= _AT_LIMIT:
                gain = -gain
            if free[k] == 0.0 and gain > most:
                chosen, most = k, gain
        if chosen < 0:
            break
        free[chosen] = 1.0


@helper
def _rid(Z: Floats, count: int) -> float:
    """Make row `count` of Z orthogonal to those before and of length 1; return what it was."""
    for _ in range(2):
        for i in range(count):
            share = 0.0
            for k in range(Z.shape[1]):
                share += Z[i, k] * Z[count, k]
            for k in range(Z.shape[1]):
                Z[count, k] -= share * Z[i, k]
    length = 0.0
    for k in range(Z.shape[1]):
        length += Z[count, k] * Z[count, k]
    length = math.sqrt(length)
    if length > 0.0:
        for k in range(Z.shape[1]):
            Z[count, k] /= length
    return length


@helper
def _self_motions(J: Floats, free: Floats, Z: Floats) -> int:
    """Write an orthonormal basis of the free joints' self-motions as rows of Z; return their count.

    Gram and Schmidt: the Jacobian's two rows, then of the unit vectors the one with most left.
    """
    total = count = 0
    for k in range(free.size):
        total += int(free[k])
    for r in range(2):
        for k in range(free.size):
            Z[count, k] = free[k] * J[r, k]
        if _rid(Z, count) > 1e-6:
            count += 1
    moving = count
    while count < total:
        best, most = -1, 1e-12
        for k in range(free.size):
            left = free[k]
            for i in range(count):
                left -= Z[i, k] * Z[i, k]
            if left > most:
                best, most = k, left
        if best < 0:
            break
        Z[count, :] = 0.0
        Z[count, best] = 1.0
        _rid(Z, count)
        count += 1
    for i in range(moving, count):
        Z[i - moving] = Z[i]
    return count - moving


@helper
def _curvature(
    p: Floats,
    d: Complexes,
    e: Complexes,
    kind: Floats,
    square: float,
    free: Floats,
    J: Floats,
    Z: Floats,
    count: int,
    d2: Complexes,
    e2: Complexes,
    J2: Floats,
    x: Floats,
    H: Floats,
) -> None:
    """Write the second derivatives of w^2 along the self-motions Z, H (count, count).

    Central differences of w^2 at points that are brought back to where the tip is.
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
                    _turned(d, e, x, 1.0, d2, e2)
                    error = tip
                    for k in range(d.size):
                        error -= d2[k]
                    y = _fit(J, free, error.real, error.imag)
                    for k in range(x.size):
                        x[k] += free[k] * _dot(complex(J[0, k], J[1, k]), y)
                _turned(d, e, x, 1.0, d2, e2)
                total += _square(p, d2, e2, kind, J2)
            H[i, j] = total / (step * step)
    for i in range(count):
        for j in range(i):
            H[i, j] = H[j, i] = 0.5 * (H[i, j] - H[i, i] - H[j, j])


@helper
def _uphill(H: Floats, b: Floats, count: int, L: Floats, u: Floats) -> None:
    """Write u = (mu I - H)^-1 b with the least mu >= 0 tried for which that leads uphill."""
    mu, good = 0.0, False
    while not good:
        good = True
        for i in range(count):
            for j in range(i + 1):
                left = -H[i, j]
                for k in range(j):
                    left -= L[i, k] * L[j, k]
                if i != j:
                    L[i, j] = left / L[j, j]
                elif left + mu > 1e-9:
                    L[i, i] = math.sqrt(left + mu)
                else:
                    good = False
            if not good:
                mu = max(4.0 * mu, 1e-3)
                break
    for i in range(count):
        left = b[i]
        for k in range(i):
            left -= L[i, k] * u[k]
        u[i] = left / L[i, i]
    for i in range(count - 1, -1, -1):
        left = u[i]
        for k in range(i + 1, count):
            left -= L[k, i] * u[k]
        u[i] = left / L[i, i]


@kernel("(p),(n,k),(k),(k),(n),()->(n),()")
def _climbed(
    p: Floats,
    limits: Floats,
    kind: Floats,
    point: Floats,
    start: Floats,
    steps: Floats,
    q_m: Floats,
    w: Floats,
) -> None:
    n = start.size
    d, e, d2, e2 = np.empty((4, n + 1), np.complex128)
    q, trial = np.zeros((2, 3 + n))
    J, J2 = np.empty((2, 3, n))
    free, free2, may, g, x, b, u = np.ones((7, n))
    Z, H, L = np.empty((3, n + 2, n))
    q[3:] = start
    target = complex(point[0], point[1])
    if not _close(p, limits, target, q, d, e, J, free, may):
        q_m[:], w[0] = math.nan, math.nan
        return
    square = _square(p, d, e, kind, J)
    for _ in range(int(steps[0])):
        _gradient(p, d, e, kind, d2, e2, J2, x, g)
        _held(d, J)
        _let_go(limits, q, J, g, free)
        steepest, longest, outward = 0.0, 0.0, 0
        while outward >= 0:  # a step out of a limit holds that joint after all
            count = _self_motions(J, free, Z)
            steepest = 0.0
            for i in range(count):
                b[i] = 0.0
                for k in range(n):
                    b[i] += Z[i, k] * g[k]
                steepest = max(steepest, abs(b[i]))
            outward = -1
            if steepest <= _FLAT:
                break
            _curvature(p, d, e, kind, square, free, J, Z, count, d2, e2, J2, x, H)
            _uphill(H, b, count, L, u)
            longest = 0.0
            for k in range(n):
                x[k] = 0.0
                for i in range(count):
                    x[k] += Z[i, k] * u[i]
                longest = max(longest, abs(x[k]))
                room = limits[k, 1] - q[3 + k] if x[k] > 0.0 else q[3 + k] - limits[k, 0]
                if abs(x[k]) > 1e-14 and room <= _AT_LIMIT:
                    outward = k
            if outward >= 0:
                free[outward] = 0.0
        if steepest <= _FLAT:
            break
        share = min(1.0, _LONGEST / longest)
        done = True  # unless a step gains more than the next one would
        for attempt in range(12):
            if attempt == 1:  # no farther than to the first limit
                for k in range(n):
                    room = limits[k, 1] - q[3 + k] if x[k] > 0.0 else q[3 + k] - limits[k, 0]
                    if share * abs(x[k]) > room:
                        share = room / abs(x[k])
            for k in range(n):
                trial[3 + k] = min(max(q[3 + k] + share * x[k], limits[k, 0]), limits[k, 1])
                room = min(trial[3 + k] - limits[k, 0], limits[k, 1] - trial[3 + k])
                may[k] = 1.0 if room > _AT_LIMIT else 0.0
            if _close(p, limits, target, trial, d2, e2, J2, free2, may):
                higher = _square(p, d2, e2, kind, J2)
                if higher > square:
                    done = attempt == 0 and longest < _SHORT
                    square = higher
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
    kind: npt.ArrayLike = FIXED,
    steps: int = 100,
) -> tuple[Floats, Floats]:
    """From posture q_m, a local maximum of w with the tip at a point (..., 2) of the base's frame.

    The tip is brought to the point by least motion; then w grows by Newton's method along the
    self-motions of the joints that no limit holds, gradient and curvature of w^2 being central
    differences.

    Args:
        p: parameters of the arm.
        q_m: where to begin.
        point: x, y [m].
        limits: within which all of it happens.
        kind: what is measured.
        steps: of Newton's method, at most; with 0, the tip is brought to the point, and no more.

    Returns:
        The posture (..., n) and its w (...); NaN where the point cannot be reached from q_m.

    Raises:
        ValueError: shapes do not fit.
    """
    q_m = np.asarray(q_m, dtype=float)
    p, _, _ = checked(p, np.concatenate([np.zeros((*q_m.shape[:-1], 3)), q_m], axis=-1))
    return _climbed(p, limits, kind, point, q_m, steps)
