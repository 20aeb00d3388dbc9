"""Arm motions that leave the base's attitude still: zero-reaction maneuvers.

Without momentum the base turns at the rate

    omega = G(q) dq_m/dt,    G the base's angular rate per joint rate (the angular coupling)

so that joint rates in the null space of G, n - 1 of them, do not turn it (Yoshida, Hashizume and
Abiko 2001; the paper's [24]). The constraint G dq_m = 0 is not integrable: which postures such
motions reach depends on their path. Straight lines of the tip under it are straight_path's.
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.momentum import generalized_jacobian, system_com
from fss_arm_workspace.regions.arcs import Floats
from fss_arm_workspace.regions.fixed import checked_limits


def angular_coupling(arm: Arm, q: npt.ArrayLike) -> Floats:
    """G of states q (..., 3 + n), (..., n): the base's angular rate per joint rate.

    Raises:
        ValueError: shapes do not fit.
    """
    return np.asarray(generalized_jacobian(arm.vector(), q)[..., 2, :] - 1.0)


def zero_reaction_rates(arm: Arm, q: npt.ArrayLike) -> Floats:
    """An orthonormal basis, (..., n - 1, n), of the joint rates that do not turn the base.

    Raises:
        ValueError: shapes do not fit.
    """
    G = angular_coupling(arm, q)
    return np.asarray(np.linalg.svd(G[..., None, :])[2][..., 1:, :])


def zero_reaction_maneuver(
    arm: Arm,
    start: npt.ArrayLike,
    wish: npt.ArrayLike,
    length: float,
    limits: npt.ArrayLike | None = None,
    *,
    step: float = 5e-3,
) -> Floats:
    """The maneuver that follows wished joint rates as closely as it can without turning the base.

        dq_m/dl = P u / |P u|,   P = 1 - G^T G / |G|^2

    Args:
        arm: the arm.
        start: state to begin from, (3 + n,).
        wish: joint rates u, (n,), of which the direction counts.
        length: of the path in the space of the joints [rad].
        limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
        step: of the Runge-Kutta method of 4th order [rad].

    Returns:
        States along the path, (m, 3 + n). It ends early where a joint would leave its limits or
        the wish has no part that does not turn the base. The centre of mass stays.

    Raises:
        ValueError: limits have the wrong shape or order.
    """
    bounds, u = checked_limits(arm, limits), np.asarray(wish, dtype=float)
    q, p = np.array(start, dtype=float), arm.vector()
    com = system_com(p, q)

    def rates(joints: Floats) -> Floats:
        state = np.concatenate([q[:3], joints])
        G = angular_coupling(arm, state)
        free = u - G * (G @ u) / (G @ G)
        size = np.linalg.norm(free)
        return free / size if size > 1e-6 * np.linalg.norm(u) else np.full_like(u, np.nan)

    states = [q]
    for h in np.diff(np.append(np.arange(0.0, length, step), length)):
        joints = states[-1][3:]
        k1 = rates(joints)
        k2 = rates(joints + 0.5 * h * k1)
        k3 = rates(joints + 0.5 * h * k2)
        k4 = rates(joints + h * k3)
        joints = joints + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if not ((joints >= bounds[:, 0]) & (joints <= bounds[:, 1])).all():
            break
        new = np.concatenate([q[:3], joints])
        new[:2] += com - system_com(p, new)
        states.append(new)
    return np.array(states)
