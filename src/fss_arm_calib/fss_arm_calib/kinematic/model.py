"""Model of the observations: predicted poses, their derivatives and the weighted residuals.

Equations and symbols are those of `problem.py`. xi (p,) are the estimated parameters.
"""

import numpy as np

from fss_arm_calib.kinematic.problem import RIPPLE_PERIODS, KinematicProblem
from fss_arm_model.arrays import Floats
from fss_arm_model.estimation.least_squares import LOSSES, Linear
from fss_arm_model.kinematics import reading_jacobian, tip_in_base, tip_regressor
from fss_arm_model.planar import wrap


def estimated_parameters(problem: KinematicProblem, values: Floats) -> Floats:
    """Return the p estimated parameters of (2n+3,) values; shared lengths are averaged."""
    return np.asarray(np.linalg.lstsq(problem.basis, values)[0])


def all_parameters(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return all parameters (2n+3,) in the order of all_names."""
    return problem.fixed + problem.basis @ xi


def vector(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return the model's parameters with xi in place of the guess, (8 + 6n,)."""
    p = problem.described.copy()
    p[problem.index] = all_parameters(problem, xi)
    return p


def residuals(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return observed minus predicted poses (Eq. 2), (s, 3) [m, m, rad], headings wrapped."""
    return pose_errors(problem, vector(problem, xi))


def pose_errors(problem: KinematicProblem, p: Floats) -> Floats:
    """Return observed minus predicted poses for the arm parameters p = Arm.vector()."""
    away = problem.tip - tip_in_base(p, problem.q)
    away[:, 2] = wrap(away[:, 2])
    return away


def derivative(problem: KinematicProblem, xi: Floats, basis: Floats | None = None) -> Floats:
    """Return Phi_k (Eq. 5), the derivative of each pose, (s, 3, p).

    A basis (2n+3, c) gives the columns (s, 3, c) of other combinations of all parameters.
    """
    Phi = tip_regressor(vector(problem, xi), problem.q)
    by_theta_E = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), (len(problem.q), 3, 1))
    basis = problem.basis if basis is None else basis
    return np.concatenate([Phi, by_theta_E], axis=-1) @ basis


def regressor(problem: KinematicProblem, xi: Floats, basis: Floats | None = None) -> Floats:
    """Return Phi_k with rows weighted by the root of W, (3s, p), of a basis as in `derivative`."""
    Phi = problem.whitening @ derivative(problem, xi, basis)
    return Phi.reshape(-1, Phi.shape[-1])


def whiten_residuals(problem: KinematicProblem, residuals: Floats) -> Floats:
    """Return the whitened residuals (s, 3)."""
    return (problem.whitening @ residuals[..., None])[..., 0]


def repeated_error_covariance(problem: KinematicProblem, xi: Floats, P: Floats) -> Floats:
    """Return what repeated reading errors add to the covariance P of xi, (p, p)."""
    if problem.reading_deviation == 0.0:
        return np.zeros_like(P)
    apart = problem.q[:, None] - problem.q
    K = problem.ripple_deviation**2 * np.cos(RIPPLE_PERIODS * apart)
    K += problem.eccentricity_deviation**2 * np.cos(apart)
    K[np.diag_indices(len(problem.q))] = 0.0
    Phi_q = problem.whitening @ reading_jacobian(vector(problem, xi), problem.q)
    Phi_k = regressor(problem, xi).reshape(*problem.q.shape[:1], 3, -1)
    G = weights(problem, xi)[:, None, None] * np.einsum("kip,kij->kjp", Phi_k, Phi_q)
    return np.asarray(P @ np.einsum("kjp,klj,ljr->pr", G, K, G) @ P)


def squared_distances(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return d_k^2, the squared length of each whitened residual, (s,)."""
    return np.asarray(np.sum(whiten_residuals(problem, residuals(problem, xi)) ** 2, axis=1))


def influence(problem: KinematicProblem, xi: Floats, P: Floats) -> Floats:
    """Return the shift (p, 2n+3) of the estimate per error (true - assumed) of a parameter."""
    weighted = np.repeat(weights(problem, xi), 3)[:, None] * regressor(problem, xi)
    return P @ weighted.T @ regressor(problem, xi, np.eye(len(problem.basis)))


def cost(problem: KinematicProblem, xi: Floats) -> float:
    """Return the cost that the iteration minimizes, sum_k rho(d_k^2)."""
    return float(np.sum(LOSSES[problem.loss].cost(squared_distances(problem, xi))))


def weights(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return the weights rho'(d_k^2), (s,)."""
    return LOSSES[problem.loss].weight(squared_distances(problem, xi))


def linearize(problem: KinematicProblem, xi: Floats) -> Linear:
    """Return the weighted problem, linearized at xi."""
    distances = squared_distances(problem, xi)
    root = np.repeat(np.sqrt(LOSSES[problem.loss].weight(distances)), 3)
    return Linear(
        residuals=root * whiten_residuals(problem, residuals(problem, xi)).ravel(),
        regressor=root[:, None] * regressor(problem, xi),
        cost=LOSSES[problem.loss].cost(distances).sum(),
    )


def is_mirrored(problem: KinematicProblem, xi: Floats) -> bool:
    """Return True if a length is negative."""
    return bool((all_parameters(problem, xi)[: problem.arm.n] < 0.0).any())


def unmirror(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return the mirror image without negative lengths: such a link is turned by pi.

    The position of the end effector does not change. Its heading changes only if the last link is
    turned and theta_E is not estimated, so that it cannot compensate.
    """
    n = problem.arm.n
    values = all_parameters(problem, xi)
    turned = np.pi * (values[:n] < 0.0)
    headings = np.cumsum([values[-2], *values[n : 2 * n - 1]]) + turned
    values[:n] = np.abs(values[:n])
    values[n : 2 * n - 1] = wrap(np.diff(headings))
    values[-2:] = wrap([headings[0], values[-1] - turned[-1]])
    return estimated_parameters(problem, values)
