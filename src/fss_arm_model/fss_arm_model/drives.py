"""The floating arm with a servo drive at each joint, stepped through time in one compiled call.

A drive reads its encoder at the start of a step and holds its torque for the step, in which the
dynamics are integrated by the classical Runge-Kutta method. Drives act between bodies, so that the
momentum stays what it was.

    off       friction of the harmonic drive: -(viscous + coulomb / sqrt(qd^2 + smooth^2)) qd
    current   the torque asked for; the drive makes up for the friction, as in the modes below
    velocity  a ramp to the velocity, which ends at the soft limit of the joint's range
    position  a trapezoid to the angle, or to the soft limit before it

Velocity and position are the same generator of a reference (r, v), which a PD servo follows:

    tau = -stiffness (q + dt qd - r) - damping (qd + dt qdd - v)

q and qd are taken a step ahead (Tan, Liu & Turk 2011, stable PD control), which is stable for any
gains and inertias as a drive's far faster current loop is.
"""

import math

import numpy as np
import numpy.typing as npt

from ._cache import Floats, helper, kernel
from .dynamics import _bias, _forward, _inertia

STEP = 0.001  # [s]
REACH, WEIGHT = (0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # Runge-Kutta's stages

#: What a drive controls, by the numbers of docs/protocol.md.
OFF, CURRENT, VELOCITY, POSITION = 0.0, 1.0, 11.0, 21.0

# For loads as the generalized inertia of four links, 0.01 to 2 kg m^2 by posture: all motion
# decays by exp(-20 t) or faster, and 1.8 N m turn the joint by 0.75 mrad.
STIFFNESS, DAMPING = 2400.0, 80.0  # [N m/rad], [N m s/rad]
VISCOUS, COULOMB, SMOOTH = 0.5, 0.3, 0.005  # [N m s/rad], [N m], [rad/s]


@helper
def _goal(mode, set_point, lowest, highest, r):  # type: ignore[no-untyped-def]
    """Where a reference at r is to go."""
    if mode == POSITION:
        return min(max(set_point, lowest), highest)
    return max(highest, r) if set_point > 0.0 else min(lowest, r)


@helper
def _profile(goal, speed, acceleration, r, v):  # type: ignore[no-untyped-def]
    """The reference (r, v) one step on: towards the goal, within speed and acceleration.

    Stopping from k dv, dv = acceleration dt, in whole steps takes k (k + 1) / 2 dv dt: the k
    that the remaining distance allows limits the speed, so that the reference lands on the goal.
    """
    dv = acceleration * STEP
    distance = abs(goal - r)
    k = 0.5 * (math.sqrt(1.0 + 8.0 * distance / (dv * STEP)) - 1.0)
    wanted = math.copysign(min(speed, k * dv, distance / STEP), goal - r)
    v += min(max(wanted - v, -dv), dv)
    return r + v * STEP, v


@helper
def _solve(A, x):  # type: ignore[no-untyped-def]
    """Replace x by A^-1 x, and the positive definite A by its Cholesky factor."""
    m = x.size
    for j in range(m):
        for k in range(j):
            x[j] -= A[j, k] * x[k]
            A[j, j] -= A[j, k] * A[j, k]
        A[j, j] = math.sqrt(A[j, j])
        x[j] /= A[j, j]
        for i in range(j + 1, m):
            for k in range(j):
                A[i, j] -= A[i, k] * A[j, k]
            A[i, j] /= A[j, j]
    for j in range(m - 1, -1, -1):
        for i in range(j + 1, m):
            x[j] -= A[i, j] * x[i]
        x[j] /= A[j, j]


@helper
def _drive(p, limits, demand, q, qd, reference, work, A, qdd, damping, tau):  # type: ignore[no-untyped-def]
    """Move the references one step on, and write the torque of each drive to tau (3 + n,).

    With the damping D of drives taken a step ahead, (H + dt D) qdd = tau(qdd = 0) - h.
    """
    _inertia(p, q, work, A)
    _bias(p, q, qd, work, qdd)
    for j in range(demand.shape[0]):
        mode, set_point, speed, acceleration = demand[j]
        r, v = q[3 + j], qd[3 + j]
        if mode == OFF:
            damping[j] = VISCOUS + COULOMB / math.sqrt(v * v + SMOOTH * SMOOTH)
            tau[3 + j] = -damping[j] * v
        elif mode == CURRENT:
            damping[j] = 0.0
            tau[3 + j] = set_point
        else:
            r, v = reference[j]
            goal = _goal(mode, set_point, limits[j, 0], limits[j, 1], r)
            r, v = _profile(goal, speed, acceleration, r, v)
            damping[j] = DAMPING
            tau[3 + j] = -STIFFNESS * (q[3 + j] + STEP * qd[3 + j] - r) - DAMPING * (qd[3 + j] - v)
        reference[j, 0], reference[j, 1] = r, v
        A[3 + j, 3 + j] += STEP * damping[j]
    for i in range(qdd.size):
        qdd[i] = tau[i] - qdd[i]
    _solve(A, qdd)
    for j in range(demand.shape[0]):
        torque = tau[3 + j] - STEP * damping[j] * qdd[3 + j]
        tau[3 + j] = min(max(torque, -limits[j, 2]), limits[j, 2])
        if torque != tau[3 + j]:
            # No torque to follow with: the reference goes on from where the joint is.
            reference[j, 0] = q[3 + j] + STEP * qd[3 + j] + tau[3 + j] / STIFFNESS
            reference[j, 1] = qd[3 + j]


@helper
def _runge_kutta(p, tau, q, qd, work, k):  # type: ignore[no-untyped-def]
    """Move (q, qd) one step on under constant forces; scratch k (6, 3 + n)."""
    x, v, dx, dv, sum_dx, sum_dv = k
    k[:] = 0.0
    for stage in range(4):
        for i in range(q.size):
            x[i] = q[i] + REACH[stage] * STEP * dx[i]
            v[i] = qd[i] + REACH[stage] * STEP * dv[i]
        _forward(p, x, v, tau, work, dv)
        for i in range(q.size):
            dx[i] = v[i]
            sum_dx[i] += WEIGHT[stage] * dx[i]
            sum_dv[i] += WEIGHT[stage] * dv[i]
    for i in range(q.size):
        q[i] += STEP * sum_dx[i]
        qd[i] += STEP * sum_dv[i]


@helper
def _copy(a, b):  # type: ignore[no-untyped-def]
    """Write a (any, any) to b."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            b[i, j] = a[i, j]


@kernel("(p),(n,l),(n,d),(s,m),(n,r),()->(s,m),(n,r)")
def _advance(p0, limits, demand, state0, reference0, steps, state, reference):  # type: ignore[no-untyped-def]
    # The dynamics are given contiguous arrays: numba takes long to compile them for other ones.
    m = state.shape[1]
    p, x = np.empty(p0.size), np.empty((3, m))
    work = np.empty((3, m - 2), np.complex128)
    A, k, qdd, damping = np.empty((m, m)), np.empty((6, m)), np.empty(m), np.empty(m - 3)
    for i in range(p.size):
        p[i] = p0[i]
    _copy(state0, x)
    _copy(reference0, reference)
    q, qd, tau = x
    for _ in range(int(steps[0])):
        _drive(p, limits, demand, q, qd, reference, work, A, qdd, damping, tau)
        _runge_kutta(p, tau, q, qd, work, k)
    _copy(x, state)


def advance(
    p: npt.ArrayLike,
    limits: npt.ArrayLike,
    demand: npt.ArrayLike,
    state: npt.ArrayLike,
    reference: npt.ArrayLike,
    steps: int,
) -> tuple[Floats, Floats]:
    """The floating arm and its drives, `steps` steps of STEP later.

    Args:
        p: (8 + 6 n,) Arm.vector().
        limits: (n, 3) of each drive: lowest and highest angle [rad], largest torque [N m].
        demand: (n, 4) of each drive: mode, set point [N m, rad/s or rad, by mode], speed [rad/s]
            and acceleration [rad/s^2] of the profile, the latter above 0 but for mode off. Position
            mode at speed 0 means: decelerate, and hold where that ends.
        state: (3, 3 + n) q, qd and tau, the generalized forces: those on the base are given and
            kept, those of the joints written.
        reference: (n, 2) where the drives want the joints [rad], and how fast [rad/s].
        steps: how many.

    Returns:
        state and reference. Leading dimensions of all arguments broadcast.
    """
    return _advance(p, limits, demand, state, reference, steps)
