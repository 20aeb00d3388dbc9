"""The floating arm under given forces, many steps in one call: one rollout or a batch of them."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from .centroidal import _bodies, _from_centroidal, _rate, _to_centroidal
from .integration import STEP, classical
from .kernels import Floats, inlined, kernel
from .kinematics import checked


@inlined
def _act(bodies, forces, turned, z, work, dz):  # type: ignore[no-untyped-def]
    """Under a force on the base's origin and torques on the bodies."""
    force, torques = forces
    _rate(bodies, turned, force, torques, z, work, dz)


_classical = classical(_act)


@kernel("(p),(m),(m),(t,m),(r),()->(t,m),(t,m)")
def _rollout(p, q0, qd0, tau, rotor, step, q, qd):  # type: ignore[no-untyped-def]
    # The dynamics are given contiguous arrays: numba takes long to compile them for other ones.
    m, kind = q0.size - 2, np.complex128
    bodies, z, k = _bodies(p.copy(), rotor.copy()), np.empty((2, 2 + m)), np.empty((3, 2, 2 + m))
    begin, turned, work = np.empty((3, m), kind), np.empty((3, m), kind), np.empty((2, m), kind)
    held = np.empty(m)
    x, xd = q0.copy(), qd0.copy()
    _to_centroidal(bodies, x, xd, begin, z)
    for t in range(tau.shape[0]):
        for i in range(m):
            held[i] = tau[t, 2 + i] - (tau[t, 3 + i] if i + 1 < m else 0.0)
        forces = complex(tau[t, 0], tau[t, 1]), held
        _classical(bodies, forces, step[0], z, begin, turned, work, k)
        _from_centroidal(bodies, begin, z, x, xd)
        for i in range(2 + m):
            q[t, i], qd[t, i] = x[i], xd[i]


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

    def part(i: int) -> None:
        cut = ... if threads == 1 or not batch else slice(i, None, threads)
        _rollout(p[cut], q[cut], qd[cut], tau[cut], rotor, step, out[0][cut], out[1][cut])

    if threads == 1 or not batch:
        part(0)
    else:
        with ThreadPoolExecutor(threads) as pool:  # a compiled kernel runs without Python's lock
            list(pool.map(part, range(threads)))
    return out
