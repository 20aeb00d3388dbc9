"""Joint motions that move the tip to a point, and self-motions that leave it there.

Functions within kernels: q (3 + n,) is a state with the base at the origin; d and e (n + 1,) are
its bodies' vectors as in kinematics.py. If joints move by small angles x (n,), these vectors are
only turned, and no trigonometric function is needed.
"""

import math

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.kernels import helper
from fss_arm_model.kinematics import dot, write_chain
from fss_arm_workspace.manipulability.measure import fixed_jacobian

_TIP_TOLERANCE = 1e-12  # distance below which the tip is at the target [m]
MAX_STEP = 0.3  # maximum step of a joint [rad]


@helper
def solve_joints(J: Floats, free: Floats, x: float, y: float) -> complex:
    """Return (J J^T)^-1 (x, y) for J's first two rows and the free joints; 0 if it is singular."""
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
def move_tip(p, limits, target, q, d, e, J, free, movable):  # type: ignore[no-untyped-def]
    """Move the tip to the target by least motion within the limits; return False on failure.

    q, d and e are updated. Only joints with 1 in `movable` (n,) move; J (3, n) and free (n,) are
    scratch.
    """
    for _ in range(30):
        write_chain(p, q, d, e)
        error = target - fixed_jacobian(d, J)
        if dot(error, error) < _TIP_TOLERANCE * _TIP_TOLERANCE:
            return True
        free[:] = movable
        longest, blocked = 0.0, True
        while blocked:  # joints that would leave their limits are held
            y = solve_joints(J, free, error.real, error.imag)
            if y == 0j:
                return False
            longest, blocked = 0.0, False
            for k in range(free.size):
                move = free[k] * dot(complex(J[0, k], J[1, k]), y)
                longest = max(longest, abs(move))
                room = limits[k, 1] - q[3 + k] if move > 0.0 else q[3 + k] - limits[k, 0]
                if move != 0.0 and room <= 0.0:
                    free[k], blocked = 0.0, True
        y *= min(1.0, MAX_STEP / longest)
        for k in range(free.size):
            move = free[k] * dot(complex(J[0, k], J[1, k]), y)
            q[3 + k] = min(max(q[3 + k] + move, limits[k, 0]), limits[k, 1])
    return False


@helper
def turn_vectors(
    d: Complexes, e: Complexes, x: Floats, sign: float, d2: Complexes, e2: Complexes
) -> None:
    """Write d2 and e2: d and e after the joints have moved by the small angles sign x (n,)."""
    d2[0], e2[0] = d[0], e[0]
    angle = 0.0
    for k in range(x.size):
        angle += sign * x[k]
        s = angle * angle
        turn = complex(1.0 - 0.5 * s + s * s / 24.0, angle * (1.0 - s / 6.0 + s * s / 120.0))
        d2[k + 1], e2[k + 1] = d[k + 1] * turn, e[k + 1] * turn


@helper
def _orthonormalize(Z: Floats, count: int) -> float:
    """Orthonormalize row `count` of Z to those before; return its length before normalization."""
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
def self_motions(J: Floats, free: Floats, Z: Floats) -> int:
    """Write an orthonormal basis of the free joints' self-motions as rows of Z; return their count.

    Gram-Schmidt method: first the Jacobian's two rows, then repeatedly the unit vector with the
    largest remainder.
    """
    total = count = 0
    for k in range(free.size):
        total += int(free[k])
    for r in range(2):
        for k in range(free.size):
            Z[count, k] = free[k] * J[r, k]
        if _orthonormalize(Z, count) > 1e-6:
            count += 1
    rank = count
    while count < total:
        best, largest = -1, 1e-12
        for k in range(free.size):
            remainder = free[k]
            for i in range(count):
                remainder -= Z[i, k] * Z[i, k]
            if remainder > largest:
                best, largest = k, remainder
        if best < 0:
            break
        Z[count, :] = 0.0
        Z[count, best] = 1.0
        _orthonormalize(Z, count)
        count += 1
    for i in range(rank, count):
        Z[i - rank] = Z[i]
    return count - rank
