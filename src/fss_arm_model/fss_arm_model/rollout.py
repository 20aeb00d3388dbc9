"""The floating arm under given forces, many steps in one call: one rollout or a batch of them."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from ._cache import Floats, helper, kernel
from .centroidal import (
    _bodies,
    _from_centroidal,
    _rate,
    _to_centroidal,
    _turn_on,
    _turned,
    _work,
)
from .kinematics import checked

STEP = 0.001  # [s]


@helper
def _runge_kutta(bodies, force, torque, step, z, begin, turned, work):  # type: ignore[no-untyped-def]
    """Move z one step on by the classical method; the bodies are turned to it in `begin`.

    The force on the base's origin and the torques on the bodies (m,) are held for the step.
    """
    x, dx, total, m = work.x, work.dx, work.total, z.shape[1]
    for r in range(2):
        for i in range(m):
            x[r, i], total[r, i] = z[r, i], 0.0
    for stage in range(4):
        if stage == 0:
            _rate(bodies, begin, force, torque, x, work, dx)
        else:
            _turn_on(bodies, begin, z, x, turned)
            _rate(bodies, turned, force, torque, x, work, dx)
        weight = step / 6 if stage in (0, 3) else step / 3
        reach = step if stage == 2 else step / 2
        for r in range(2):
            for i in range(m):
                total[r, i] += weight * dx[r, i]
                x[r, i] = z[r, i] + reach * dx[r, i]
    for r in range(2):
        for i in range(m):
            x[r, i] = z[r, i] + total[r, i]
    _turn_on(bodies, begin, z, x, begin)
    for r in range(2):
        for i in range(m):
            z[r, i] = x[r, i]


@kernel("(p),(m),(m),(t,m),(r),()->(t,m),(t,m)")
def _rollout(p, q0, qd0, tau, rotor, step, q, qd):  # type: ignore[no-untyped-def]
    m = q0.size - 2
    bodies, begin, turned, work = _bodies(p.copy(), rotor), _turned(m), _turned(m), _work(m)
    z, torque = np.empty((2, 2 + m)), np.empty(m)
    _to_centroidal(bodies, q0, qd0, begin, z)
    for t in range(tau.shape[0]):
        for k in range(m):
            torque[k] = tau[t, 2 + k] - (tau[t, 3 + k] if k + 1 < m else 0.0)
        force = complex(tau[t, 0], tau[t, 1])
        _runge_kutta(bodies, force, torque, step[0], z, begin, turned, work)
        _from_centroidal(bodies, begin, z, q[t], qd[t])


def rollout(
    p: npt.ArrayLike,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    tau: npt.ArrayLike,
    step: float = STEP,
    rotor: tuple[float, float] = (0.0, 0.0),
    threads: int = 1,
) -> tuple[Floats, Floats]:
    """The floating arm's motion under given forces, by the classical Runge-Kutta method.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q: (..., 3 + n) state at the begin: base x, y [m], theta, q_1 .. q_n [rad].
        qd: (..., 3 + n) its rate.
        tau: (..., steps, 3 + n) generalized forces, each held for a step: force on the base's
            origin, in world axes [N], torque on the base and joint torques [N m].
        step: [s].
        rotor: N^2 J and N J [kg m^2] of each joint's rotor of inertia J that turns N times as fast.
        threads: that share the first dimension of a batch.

    Returns:
        q and qd, (..., steps, 3 + n), after each step. Leading dimensions broadcast.

    Raises:
        ValueError: shapes do not fit, or step or threads is not positive.
    """
    p, q, n = checked(p, q)
    qd, tau = np.asarray(qd, dtype=float), np.asarray(tau, dtype=float)
    if qd.shape[-1:] != (3 + n,) or tau.ndim < 2 or tau.shape[-1] != 3 + n:
        raise ValueError(f"qd and tau have the shapes {qd.shape} and {tau.shape}, n is {n}")
    if not step > 0.0 or threads < 1:
        raise ValueError(f"step is {step} and threads {threads}, expected more than 0")
    batch = np.broadcast_shapes(p.shape[:-1], q.shape[:-1], qd.shape[:-1], tau.shape[:-2])
    p, q, qd = (np.broadcast_to(x, (*batch, x.shape[-1])) for x in (p, q, qd))
    tau = np.broadcast_to(tau, (*batch, *tau.shape[-2:]))
    out = np.empty(tau.shape), np.empty(tau.shape)
    arguments = p, q, qd, tau

    def part(i: int) -> None:
        _rollout(*(x[i::threads] for x in arguments), rotor, step, *(x[i::threads] for x in out))

    if threads == 1 or not batch:
        _rollout(*arguments, rotor, step, *out)
    else:
        with ThreadPoolExecutor(threads) as pool:  # a compiled kernel runs without Python's lock
            list(pool.map(part, range(threads)))
    return out
