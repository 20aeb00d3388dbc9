"""Solver for the lengths and angles that fit the observations best (Eq. 4), and its result."""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import Fit, Linear, Minimum, minimize
from fss_arm_model.estimation.noise import ResidualSums
from fss_arm_model.estimation.statistics import root_mean_square
from fss_arm_model.estimation.variances import restricted_log_likelihood
from fss_arm_model.kinematics import tip_regressor
from fss_arm_model.planar import wrap


class Prediction(NamedTuple):
    """Prediction of k observations that the result was not estimated from."""

    residuals: Floats  # (k, 3) observed minus predicted [m, m, rad]
    normalized: Floats  # (k,) lengths, normalized by their covariance, as in KinematicResult
    chi_square: float  # of all k observations, with 3k degrees of freedom


@dataclass(frozen=True)
class KinematicResult(Fit):
    """Estimate of p parameters from s observations, with its uncertainty.

    With a robust loss the covariance is that of the weighted observations.
    """

    problem: KinematicProblem
    max_share: ClassVar = 1e-3

    @cached_property
    def values(self) -> Floats:
        """Estimates (p,) in the order of problem.names, angles wrapped."""
        angles = np.array(self.problem.units) == "rad"
        return np.where(angles, wrap(self.minimum.x), self.minimum.x)

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (p, p), with repeated reading errors and those of assumed parameters."""
        problem, xi, P = self.problem, self.minimum.x, self.random
        G = model.influence(problem, xi, P)
        repeated = model.repeated_error_covariance(problem, xi, P)
        return np.asarray(P + repeated + G @ problem.fixed_covariance @ G.T)

    @cached_property
    def residuals(self) -> Floats:
        """Observed minus predicted poses, (s, 3) [m, m, rad]."""
        return model.residuals(self.problem, self.minimum.x)

    @cached_property
    def weights(self) -> Floats:
        """Weights (s,) of the loss: less than 1 for large residuals."""
        return model.weights(self.problem, self.minimum.x)

    @property
    def chi_square(self) -> float:
        """Weighted sum of squared residuals."""
        return float(self.weights @ model.squared_distances(self.problem, self.minimum.x))

    @property
    def position_residual(self) -> float:
        """Standard deviation of the 2s position residuals: root mean square about zero [m]."""
        return root_mean_square(self.residuals[:, :2])

    @property
    def heading_residual(self) -> float:
        """Standard deviation of the s heading residuals: root mean square about zero [rad]."""
        return root_mean_square(self.residuals[:, 2])

    @cached_property
    def derivative(self) -> Floats:
        """Derivative of the poses by the parameters, (s, 3, p)."""
        return model.derivative(self.problem, self.values)

    def _prediction_covariance(self, problem: KinematicProblem, covariance: Floats) -> Floats:
        """Return the whitened covariance (s, 3, 3) of predictions due to the parameters."""
        Phi = model.regressor(problem, self.values).reshape(-1, 3, len(self.values))
        return np.asarray(Phi @ covariance @ np.swapaxes(Phi, 1, 2))

    @cached_property
    def _hat(self) -> Floats:
        """Whitened covariance (s, 3, 3) of the observations' own predictions."""
        return self._prediction_covariance(self.problem, self.random)

    @property
    def residual_sums(self) -> ResidualSums | None:
        """Squared residuals and degrees of freedom of positions and headings."""
        if self.undetermined:
            return None
        hat = np.diagonal(self._hat, axis1=1, axis2=2)
        squares = self.weights[:, None] * model.whiten_residuals(self.problem, self.residuals) ** 2
        freedom = self.weights[:, None] * (1.0 - self.weights[:, None] * hat)
        parts = [np.array([np.sum(x[:, :2]), np.sum(x[:, 2])]) for x in (squares, freedom)]
        return ResidualSums(*parts)

    def restricted_log_likelihood(self, variances: Floats) -> Floats:
        """Return the log likelihood (...) of variances (..., 3), as in KinematicProblem."""
        Phi, covariance = self.derivative, self.problem.covariance(variances)
        return restricted_log_likelihood(self.residuals, Phi, self.weights, covariance)

    @cached_property
    def leverage(self) -> Floats:
        """Leverage (s,): mean diagonal of the hat matrix, 0 to 1; the average is p / 3s."""
        return np.asarray(self.weights * np.trace(self._hat, axis1=1, axis2=2) / 3.0)

    @cached_property
    def normalized_residuals(self) -> Floats:
        """Lengths (s,) of the residuals, normalized by their own covariance, 1 - hat."""
        hat = self.weights[:, None, None] * self._hat
        return _mahalanobis(model.whiten_residuals(self.problem, self.residuals), np.eye(3) - hat)

    def predict(self, problem: KinematicProblem) -> Prediction:
        """Predict observations that were not used for the estimate."""
        residuals = model.residuals(problem, self.values)
        z, Phi = model.whiten_residuals(problem, residuals), model.regressor(problem, self.values)
        # z' (1 + Phi C Phi')^-1 z, by the matrix inversion lemma
        v, C = Phi.T @ z.ravel(), self.covariance
        off = v @ np.linalg.solve(np.eye(len(v)) + C @ Phi.T @ Phi, C @ v)
        normalized = _mahalanobis(z, np.eye(3) + self._prediction_covariance(problem, C))
        return Prediction(residuals, normalized, float(np.sum(z**2) - off))

    def calibrated(self) -> Arm:
        """Return the arm with the estimates; DescriptionError: a length is not positive."""
        problem, basis, fixed = self.problem, self.problem.basis, self.problem.fixed_covariance
        *values, theta_E = model.all_parameters(problem, self.values).tolist()
        cross = basis @ model.influence(problem, self.values, self.random) @ fixed
        C = basis @ self.covariance @ basis.T + fixed - cross - cross.T
        uncertain = np.flatnonzero(np.diag(C) > 0.0)
        names = [problem.all_names[k] for k in uncertain]
        known = problem.arm.known.updated(names, C[np.ix_(uncertain, uncertain)])
        return replace(problem.arm.with_kinematics(values), theta_E=theta_E, known=known)


def _mahalanobis(z: Floats, covariance: Floats) -> Floats:
    """Return sqrt(z' covariance^-1 z) of each, (s,), where the covariance is not singular."""
    inverse = np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
    return np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", z, inverse, z), 0.0))


@dataclass(frozen=True)
class RestMeasurements:
    """Rests in the joint estimate; they have no unknowns of their own."""

    problem: KinematicProblem

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates of the poses."""
        return self.problem.tip.size

    def initial_unknowns(self) -> Floats:
        """Return an empty vector: rests have no unknowns of their own."""
        return np.empty(0)

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the pose residuals near z, divided by their standard deviations."""
        problem, n = self.problem, self.problem.arm.n
        p = z[: layout.size(n)]
        J = np.zeros((*problem.tip.shape, len(z)))
        J[..., layout.kinematic_index(n)] = tip_regressor(p, problem.q)
        J[:, 2, layout.TIP_ANGLE] = 1.0
        r = model.whiten_residuals(problem, model.pose_errors(problem, p)).ravel()
        rows = (problem.whitening @ J).reshape(len(r), len(z))
        return Linear(r, rows, r @ r, lambda dz: dz)


MAX_ITERATIONS = 200


class NotIdentifiable(ValueError):  # noqa: N818
    """Error raised if some parameters are not identifiable; the message names them."""

    def __init__(self, parameters: tuple[str, ...], undetermined: int, condition: float) -> None:
        self.parameters, self.undetermined, self.condition = parameters, undetermined, condition
        super().__init__(
            f"{', '.join(parameters)} cannot be separated ({undetermined} "
            f"combination{'s' * (undetermined > 1)} undetermined, condition number {condition:.3g})"
        )


def solve(
    problem: KinematicProblem,
    tolerance: float = 1e-9,
    max_condition: float = 1e3,
    start: npt.ArrayLike | None = None,
) -> KinematicResult:
    """Fit as `fit` does; NotIdentifiable: the observations do not determine all parameters."""
    result = fit(problem, tolerance, max_condition, start)
    if result.undetermined:
        raise NotIdentifiable(result.undetermined, result.missing, result.condition_number)
    return result


def fit(
    problem: KinematicProblem,
    tolerance: float = 1e-9,
    max_condition: float = 1e3,
    start: npt.ArrayLike | None = None,
) -> KinematicResult:
    """Iterate Eq. 4 (Gauss-Newton) from several starts and return the solution of lowest cost.

    One start is the guess, of the arm or `start` (p,), with lengths and mount solved linearly for
    the guessed angles. The other start is the closed form. Mirrored solutions are folded back. The
    result names the parameters that are not identifiable. Tolerance and limit of the condition
    number are those of `minimize`.
    """
    guess = problem.guess if start is None else np.asarray(start, dtype=float)
    starts = [_linear_start(problem, guess), *_closed_form_start(problem)]
    freedom = max(problem.tip.size - len(guess), 1)
    fits: list[Minimum] = []

    def iterate(xi: Floats) -> Minimum:
        start, linearize = model.unmirror(problem, xi), partial(model.linearize, problem)
        found = minimize(linearize, start, None, tolerance, MAX_ITERATIONS, max_condition)
        fits.append(found)
        return found

    for xi in sorted(starts, key=partial(model.cost, problem)):
        fit = iterate(xi)
        if model.is_mirrored(problem, fit.x):
            fit = iterate(fit.x)
        if fit.converged and fit.cost < freedom + 10.0 * np.sqrt(2.0 * freedom):
            break  # any better minimum would be better only by chance
    best = min(fits, key=lambda fit: (not fit.converged, fit.cost))
    return KinematicResult(problem, best)


def _link_phasors(problem: KinematicProblem) -> npt.NDArray[np.complex128]:
    """Return exp(i Q_i) with Q_i = q_1 + .. + q_i, (s, n)."""
    return np.asarray(np.exp(1j * np.cumsum(problem.q, axis=1)))


def _linear_start(problem: KinematicProblem, xi: Floats) -> Floats:
    """Return a start with the angles of xi, and the lengths and mount that fit best to them."""
    n = problem.arm.n
    values = model.all_parameters(problem, xi)
    headings = np.cumsum([values[-2], *values[n : 2 * n - 1]])
    ones = np.ones(len(problem.q))
    columns = np.column_stack([_link_phasors(problem) * np.exp(1j * headings), ones, 1j * ones])
    linear = np.flatnonzero(np.array(problem.units) == "m")
    rows = [*range(n), 2 * n - 1, 2 * n]  # of lengths and mount
    by_linear = columns @ problem.basis[np.ix_(rows, linear)]
    off = problem.tip[:, 0] + 1j * problem.tip[:, 1] - columns @ values[rows]
    stacked = np.concatenate([by_linear.real, by_linear.imag])
    xi = xi.copy()
    xi[linear] += np.linalg.lstsq(stacked, np.concatenate([off.real, off.imag]))[0]
    return xi


def _closed_form_start(problem: KinematicProblem) -> list[Floats]:
    """Return a start from the positions, without a guess; none if they do not suffice.

    With complex numbers as vectors in the plane and Q_i = q_1 + .. + q_i, the end effector is at

        x + i y = m + sum_i z_i exp(i Q_i)
        z_i = a_i exp(i (theta_BJ1 + theta_0_2 + .. + theta_0_i))

    which is linear in the mount m and the z_i. Lengths found as |z_i| are never negative, so this
    start also keeps the iteration from the mirrored arms that fit the positions as well.
    """
    n, turns = problem.arm.n, _link_phasors(problem)
    columns = np.column_stack([np.ones(len(turns)), turns])
    positions = problem.tip[:, 0] + 1j * problem.tip[:, 1]
    z, _, rank, _ = np.linalg.lstsq(columns, positions)
    if rank < n + 1 or not np.all(z[1:]):
        return []
    headings = np.angle(z[1:])
    seen = np.exp(1j * (problem.tip[:, 2] - headings[-1])) / turns[:, -1]
    mount = [z[0].real, z[0].imag, headings[0], np.angle(np.mean(seen))]
    values = np.concatenate([np.abs(z[1:]), wrap(np.diff(headings)), mount])
    return [model.estimated_parameters(problem, values)]
