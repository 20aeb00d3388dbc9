"""Rules by which the joints share the tip's motion along a straight line.

Along the line's length s, the joints move at the rates x = dq_m/ds that minimize

    (x - z)^T W (x - z)    with    A x = b    and no joint beyond its limits.

A x = b keeps the tip on the line: A has the first two rows of the tip's Jacobian (J_m if the base
is fixed, J* if it floats without momentum), and b is the line's direction. For zero reaction, a
third row makes the base's angular rate zero. The rule that resolves the redundancy chooses z and W:

    minimum norm          z = 0                                W = 1
    away from limits      z_i = -gain (q_i - mid_i) / half_i   W = 1          (Liegeois 1977)
    weighted least norm   z = 0                                W_i = 1 + |dH/dq_i| for joints that
                          move from the middle, else 1              (Chan and Dubey 1995)

    H = sum of (max_i - min_i)^2 / (4 (max_i - q_i) (q_i - min_i))
"""

import math

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.kernels import helper
from fss_arm_model.kinematics import write_chain
from fss_arm_model.momentum import write_floating_jacobian
from fss_arm_workspace.manipulability.measure import fixed_jacobian

BASES = ("fixed", "floating", "zero reaction")
RULES = ("minimum norm", "away from limits", "weighted least norm")

_WEIGHTED_TOLERANCE = (
    1e-3  # distance below which weights almost stop a joint, so that it is at its limit [rad]
)
LIMIT_TOLERANCE = 1e-11  # distance below which a joint is at its limit [rad]


@helper
def _solve(C: Floats, rows: int, y: Floats) -> bool:
    """Solve C y' = y in place; return False if C is singular. Symmetric C is overwritten."""
    for i in range(rows):
        scale = C[i, i]
        for k in range(i):
            C[i, i] -= C[i, k] * C[i, k]
        if not C[i, i] > 1e-13 * scale:
            return False
        C[i, i] = math.sqrt(C[i, i])
        for j in range(i + 1, rows):
            for k in range(i):
                C[j, i] -= C[j, k] * C[i, k]
            C[j, i] /= C[i, i]
        for k in range(i):
            y[i] -= C[i, k] * y[k]
        y[i] /= C[i, i]
    for i in range(rows - 1, -1, -1):
        for k in range(i + 1, rows):
            y[i] -= C[k, i] * y[k]
        y[i] /= C[i, i]
    return True


@helper
def least_rates(
    A: Floats, rows: int, free: Floats, z: Floats, W: Floats, C: Floats, y: Floats, x: Floats
) -> bool:
    """Write the free joints' x with A x = y nearest to z, and multipliers y; False if singular."""
    for i in range(rows):
        for j in range(i + 1):
            C[i, j] = 0.0
            for k in range(x.size):
                C[i, j] += free[k] * A[i, k] * A[j, k] / W[k]
        for k in range(x.size):
            y[i] -= free[k] * A[i, k] * z[k]
    if not _solve(C, rows, y):
        return False
    for k in range(x.size):
        x[k] = 0.0
        for i in range(rows):
            x[k] += A[i, k] * y[i]
        x[k] = free[k] * (z[k] + x[k] / W[k])
    return True


@helper
def constraint_rows(
    p: Floats, q: Floats, base: float, d: Complexes, e: Complexes, A: Floats
) -> None:
    """Write A (3, n): the tip's two rows, and the base's angular rate per joint rate."""
    write_chain(p, q, d, e)
    if base > 0.0:
        write_floating_jacobian(p, d, e, A)
        for k in range(A.shape[1]):
            A[2, k] -= 1.0
    else:
        fixed_jacobian(d, A)
        A[2] = 0.0


@helper
def _weight(low: float, high: float, angle: float) -> float:
    """Return 1 + |dH/dq| of one joint."""
    room = max(high - angle, LIMIT_TOLERANCE) * max(angle - low, LIMIT_TOLERANCE)
    side = (high - low) / (2.0 * room)
    return 1.0 + side * side * abs(2.0 * angle - high - low)


@helper
def joint_rates(  # type: ignore[no-untyped-def]
    limits, q, A, rows, rule, gain, direction, free, z, W, C, y, x
):
    """Write the free joints' rates x (n,) [rad/m] by the rule; return False if there are none."""
    z[:] = 0.0
    W[:] = 1.0
    for k in range(x.size):
        low, high, angle = limits[k, 0], limits[k, 1], q[3 + k]
        if rule == 1.0:
            z[k] = -gain * (2.0 * angle - high - low) / (high - low)
        elif rule == 2.0:
            W[k] = _weight(low, high, angle)
    # W depends on the rates and they on W; the cost is convex, so few iterations find its minimum.
    for _ in range(2 * x.size):
        y[0], y[1], y[2] = direction.real, direction.imag, 0.0
        if not least_rates(A, rows, free, z, W, C, y, x):
            return False
        settled = True
        for k in range(x.size if rule == 2.0 else 0):
            low, high, angle = limits[k, 0], limits[k, 1], q[3 + k]
            outward = x[k] * (2.0 * angle - high - low) > 0.0
            weight = _weight(low, high, angle) if outward else 1.0
            settled &= weight == W[k]
            W[k] = weight
        if settled:
            break
    return True


@helper
def at_limit(limits: Floats, q: Floats, k: int, rule: float) -> float:
    """Return -1 or 1 if joint k is at its lowest or highest reading, else 0."""
    tolerance = _WEIGHTED_TOLERANCE if rule == 2.0 else LIMIT_TOLERANCE
    if q[3 + k] - limits[k, 0] <= tolerance:
        return -1.0
    if limits[k, 1] - q[3 + k] <= tolerance:
        return 1.0
    return 0.0


@helper
def choose_free_joints(  # type: ignore[no-untyped-def]
    limits, q, A, rows, rule, gain, direction, free, rates, C, x
):
    """Write which joints are free (n,), and their rates x; return whether rates exist, and a count.

    The count is that of the free joints. Joints that would move beyond a limit are held, the
    fastest first, until none would. A held joint is released if its multiplier shows that moving
    inwards lowers the cost.
    """
    n = x.size
    z, W, y = rates[0, :n], rates[1, :n], rates[2]
    free[:] = 1.0
    count = n
    for _ in range(4 * n):
        if count < rows:
            return False, count
        if not joint_rates(limits, q, A, rows, rule, gain, direction, free, z, W, C, y, x):
            return False, count
        chosen, largest = -1, 0.0
        for k in range(n):
            out = free[k] * x[k] * at_limit(limits, q, k, rule)
            if out > largest:
                chosen, largest = k, out
        if chosen >= 0:
            free[chosen] = 0.0
            count -= 1
            continue
        largest = 1e-9
        for k in range(n):
            pull = W[k] * z[k]
            for i in range(rows):
                pull += A[i, k] * y[i]
            inward = -(1.0 - free[k]) * pull * at_limit(limits, q, k, rule)
            if inward > largest:
                chosen, largest = k, inward
        if chosen < 0:
            break
        free[chosen] = 1.0
        count += 1
    return True, count
