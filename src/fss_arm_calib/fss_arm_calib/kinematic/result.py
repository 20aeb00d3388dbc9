"""Result of a kinematic calibration: estimates, uncertainty and predictions."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.noise import ResidualSums
from fss_arm_calib.estimation.statistics import root_mean_square
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm


class Prediction(NamedTuple):
    """Prediction of k observations that the result was not estimated from."""

    residuals: Floats  # (k, 3) observed minus predicted [m, m, rad]
    normalized: Floats  # (k,) lengths, normalized by their covariance, as in KinematicResult
    chi_square: float  # of all k observations, with 3k degrees of freedom


@dataclass(frozen=True)
class KinematicResult:
    """Estimate of p parameters from s observations, with its uncertainty.

    With a robust loss the covariance is that of the weighted observations.
    """

    problem: KinematicProblem
    values: Floats  # (p,) in the order and units of problem.names and problem.units
    covariance: Floats  # (p, p)
    weighted: Floats  # (p, p) part of it due to observation errors, (Phi_k' W Phi_k)^-1
    residuals: Floats  # (s, 3) observed minus predicted [m, m, rad]
    weights: Floats  # (s,) weights of the loss: less than 1 for large residuals
    chi_square: float  # weighted sum of squared residuals
    condition_number: float  # of the column-scaled regressor
    iterations: int
    last_update: float  # largest change in the last iteration, in standard deviations
    converged: bool
    undetermined: tuple[str, ...] = ()  # parameters that the observations do not separate
    missing: int = 0  # number of undetermined combinations of them

    @property
    def deviations(self) -> Floats:
        """Standard deviation of each parameter, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom, 3s - p."""
        return self.residuals.size - self.values.size

    @property
    def position_residual(self) -> float:
        """Standard deviation of the 2s position residuals: root mean square about zero [m]."""
        return root_mean_square(self.residuals[:, :2])

    @property
    def heading_residual(self) -> float:
        """Standard deviation of the s heading residuals: root mean square about zero [rad]."""
        return root_mean_square(self.residuals[:, 2])

    def _prediction_covariance(self, problem: KinematicProblem, covariance: Floats) -> Floats:
        """Return the whitened covariance (s, 3, 3) of predictions due to the parameters."""
        Phi = model.regressor(problem, self.values).reshape(-1, 3, len(self.values))
        return np.asarray(Phi @ covariance @ np.swapaxes(Phi, 1, 2))

    @property
    def residual_sums(self) -> ResidualSums | None:
        """Squared residuals and degrees of freedom of positions and headings."""
        if self.undetermined:
            return None
        hat = np.diagonal(
            self._prediction_covariance(self.problem, self.weighted), axis1=1, axis2=2
        )
        squares = self.weights[:, None] * model.whiten_residuals(self.problem, self.residuals) ** 2
        freedom = self.weights[:, None] * (1.0 - self.weights[:, None] * hat)
        parts = [np.array([np.sum(x[:, :2]), np.sum(x[:, 2])]) for x in (squares, freedom)]
        return ResidualSums(*parts)

    @cached_property
    def leverage(self) -> Floats:
        """Leverage (s,): how much an observation determines its own prediction, 0 to 1.

        It is the mean of the observation's three diagonal elements of the hat matrix. The average
        is p / 3s.
        """
        hat = self.weights * np.trace(
            self._prediction_covariance(self.problem, self.weighted), axis1=1, axis2=2
        )
        return np.asarray(hat / 3.0)

    @cached_property
    def normalized_residuals(self) -> Floats:
        """Lengths (s,) of the residuals, normalized by their own covariance, 1 - hat.

        For correct observations, the squares have a chi-square distribution with 3 degrees of
        freedom.
        """
        hat = self.weights[:, None, None] * self._prediction_covariance(self.problem, self.weighted)
        return _mahalanobis(model.whiten_residuals(self.problem, self.residuals), np.eye(3) - hat)

    def predict(self, problem: KinematicProblem) -> Prediction:
        """Predict observations that were not used for the estimate."""
        residuals = model.residuals(problem, self.values)
        z, Phi = model.whiten_residuals(problem, residuals), model.regressor(problem, self.values)
        # z' (1 + Phi C Phi')^-1 z, by the matrix inversion lemma
        v, C = Phi.T @ z.ravel(), self.covariance
        chi_square = float(
            np.sum(z**2) - v @ np.linalg.solve(np.eye(len(v)) + C @ Phi.T @ Phi, C @ v)
        )
        return Prediction(
            residuals,
            _mahalanobis(z, np.eye(3) + self._prediction_covariance(problem, C)),
            chi_square,
        )

    def calibrated(self) -> Arm:
        """Return the initial arm with the estimated parameters.

        Raises:
            DescriptionError: a length is not positive.
        """
        problem, arm = self.problem, self.problem.arm
        *values, theta_E = model.all_parameters(problem, self.values).tolist()
        cross = (
            problem.basis
            @ model.influence(problem, self.values, self.weighted)
            @ problem.fixed_covariance
        )
        C = (
            problem.basis @ self.covariance @ problem.basis.T
            + problem.fixed_covariance
            - cross
            - cross.T
        )
        uncertain = np.flatnonzero(np.diag(C) > 0.0)
        known = arm.known.updated(
            [problem.all_names[k] for k in uncertain], C[np.ix_(uncertain, uncertain)]
        )
        return replace(arm.with_kinematics(values), theta_E=theta_E, known=known)


def _mahalanobis(z: Floats, covariance: Floats) -> Floats:
    """Return sqrt(z' covariance^-1 z) of each, (s,), where the covariance is not singular."""
    inverse = np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
    return np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", z, inverse, z), 0.0))
