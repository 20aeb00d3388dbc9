"""Loads that the joints of the floating arm transmit, and the inertia that they feel.

There are no external forces and no momentum. The motion of the base follows from

    H_b a_b = -(H_bm qdd + h_b),    H_b v_b = -H_bm qd
"""

import numpy as np

from .arrays import Floats
from .dynamics import bias, inertia_matrix, inverse_dynamics
from .layout import LINK_MASS, MOUNT_ANGLE, OFFSET, com, each, reach


def transmitted_loads(p: Floats, q: Floats, qd: Floats, qdd: Floats) -> tuple[Floats, Floats]:
    """Return torques and forces transmitted by the joints of the floating arm.

    A tilt of the table accelerates all masses equally and has no effect.

    Args:
        p: (8 + 6 n,) Arm.vector().
        q: (k, n) joint readings [rad].
        qd: (k, n) their rates [rad/s].
        qdd: (k, n) their accelerations [rad/s^2].

    Returns:
        The torque (k, n) [N m], and the force across each link (k, n) [N] that accelerates its mass
        and all masses beyond it.
    """
    n = q.shape[1]
    state = np.concatenate([np.zeros((len(q), 3)), q], axis=1)
    H = inertia_matrix(p, state)
    base, coupling = H[:, :3, :3], H[:, :3, 3:]
    twist = -np.linalg.solve(base, coupling @ qd[..., None])[..., 0]
    rate = np.concatenate([twist, qd], axis=1)
    push = (coupling @ qdd[..., None])[..., 0] + bias(p, state, rate)[:, :3]
    pull = -np.linalg.solve(base, push[..., None])[..., 0]
    torque = inverse_dynamics(p, state, rate, np.concatenate([pull, qdd], axis=1))[:, 3:]
    offsets = np.concatenate([[p[MOUNT_ANGLE]], each(p, OFFSET)[1:]])
    psi = np.cumsum(np.column_stack([np.zeros(len(q)), q + offsets]), axis=1)
    turns = np.exp(1j * psi)
    spins = np.cumsum(rate[:, 2:], axis=1)
    gains = np.cumsum(np.column_stack([pull[:, 2], qdd]), axis=1)
    turning = (1j * gains - spins**2) * turns
    acceleration = pull[:, 0] + 1j * pull[:, 1] + reach(p, 0) * turning[:, 0]
    forces = []
    for k in range(1, n + 1):
        forces.append(each(p, LINK_MASS)[k - 1] * (acceleration + com(p, k) * turning[:, k]))
        acceleration = acceleration + reach(p, k) * turning[:, k]
    beyond = np.cumsum(np.column_stack(forces)[:, ::-1], axis=1)[:, ::-1]
    return torque, (np.conj(1j * turns[:, 1:]) * beyond).real


def reduced_inertia(p: Floats, q: Floats) -> Floats:
    """Return the inertia (k, n, n) that the joints feel at readings (k, n), the base being free."""
    H = inertia_matrix(p, np.concatenate([np.zeros((len(q), 3)), q], axis=1))
    free = np.linalg.solve(H[:, :3, :3], H[:, :3, 3:])
    return np.asarray(H[:, 3:, 3:] - np.swapaxes(H[:, :3, 3:], 1, 2) @ free)
