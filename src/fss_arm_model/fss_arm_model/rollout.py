"""Simulate the floating arm under given forces: many steps and many rollouts in one call."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .integration import STEP
from .kernels import kernel
from .kinematics import checked
from .lanes import roll_lanes

LANES = 16  # two rows of the widest vectors, so that one is computed while the other waits
LAYOUT = "(l,p),(l,m),(l,m),(l,t,m),(r),(a),()->(l,t,m),(l,t,m)"
MIN_LANES = 4  # for fewer rollouts, single ones are faster than a row of lanes
FREE = (0.0, 0.0, 0.0, 0.0, 0.0)


@kernel(LAYOUT)
def _rollout(p, q0, qd0, tau, rotor, around, step, q, qd):  # type: ignore[no-untyped-def]
    roll_lanes(1, p, q0, qd0, tau, rotor, around, step, q, qd)


@kernel(LAYOUT)
def _rollouts(p, q0, qd0, tau, rotor, around, step, q, qd):  # type: ignore[no-untyped-def]
    roll_lanes(LANES, p, q0, qd0, tau, rotor, around, step, q, qd)


def rollout(
    p: npt.ArrayLike,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    tau: npt.ArrayLike,
    step: float = STEP,
    rotor: tuple[float, float] = (0.0, 0.0),
    around: npt.ArrayLike = FREE,
    threads: int = 1,
) -> tuple[Floats, Floats]:
    """Simulate the floating arm under given forces, by the classical Runge-Kutta method.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q: (..., 3 + n) state at the start: base x, y [m], theta, q_1 .. q_n [rad].
        qd: (..., 3 + n) its rate.
        tau: (..., steps, 3 + n) generalized forces, each held for a step: force on the base's
            origin, in world axes [N], torque on the base and joint torques [N m].
        step: length of a step [s].
        rotor: N^2 J and N J [kg m^2] of each joint's rotor of inertia J that turns N times as fast.
        around: (5,) external effects on the whole system: acceleration down the table's slope along
            x and y [m/s^2], shear of the air film per mass and velocity [1/s], drag of the hose on
            the base's origin [N s/m] and against its rotation [N m s].
        threads: number of threads that share a batch.

    Returns:
        q and qd, (..., steps, 3 + n), after each step. Leading dimensions broadcast.

    Raises:
        ValueError: shapes do not fit, or step or threads is not positive.
    """
    p, q, n = checked(p, q)
    qd, tau, around = np.asarray(qd, float), np.asarray(tau, float), np.asarray(around, float)
    if qd.shape[-1:] != (3 + n,) or tau.ndim < 2 or tau.shape[-1] != 3 + n:
        raise ValueError(f"qd and tau have the shapes {qd.shape} and {tau.shape}, n is {n}")
    if around.shape != (5,):
        raise ValueError(f"around has the shape {around.shape}, expected (5,)")
    if not step > 0.0 or threads < 1:
        raise ValueError(f"step is {step} and threads {threads}, expected more than 0")
    batch = np.broadcast_shapes(p.shape[:-1], q.shape[:-1], qd.shape[:-1], tau.shape[:-2])
    steps, count = tau.shape[-2], math.prod(batch)
    inputs = [
        np.broadcast_to(x, (*batch, *x.shape[-core:])).reshape(count, *x.shape[-core:])
        for x, core in ((p, 1), (q, 1), (qd, 1), (tau, 2))
    ]
    out = np.empty((count, steps, 3 + n)), np.empty((count, steps, 3 + n))

    def roll(start: int) -> None:
        batch_inputs = [x[start : start + LANES] for x in inputs]
        compiled = _rollouts
        if len(batch_inputs[0]) < MIN_LANES:
            batch_inputs, compiled = [x[:, None] for x in batch_inputs], _rollout
        elif len(batch_inputs[0]) < LANES:
            batch_inputs = [
                np.concatenate([x, np.repeat(x[-1:], LANES - len(x), axis=0)]) for x in batch_inputs
            ]
        results = compiled(*batch_inputs, rotor, around, step)
        for output, part in zip(out, results, strict=True):
            target = output[start : start + LANES]
            target[...] = part.reshape(-1, steps, 3 + n)[: len(target)]

    starts = range(0, count, LANES)
    if threads == 1:
        list(map(roll, starts))
    else:
        with ThreadPoolExecutor(threads) as pool:  # a compiled kernel releases Python's lock
            list(pool.map(roll, starts))
    q, qd = (x.reshape(*batch, steps, 3 + n) for x in out)
    return q, qd
