"""What a kinematic calibration finds, how far to believe it, and what it predicts."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.estimation.noise import Left
from fss_arm_calib.estimation.statistics import root_mean_square
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_model.description import Arm


class Prediction(NamedTuple):
    """What a result says of k observations that it is not from."""

    residuals: Floats  # (k, 3) observed minus predicted [m, m, rad]
    normalized: Floats  # (k,) their lengths by the covariance of each, as in KinematicResult
    chi_square: float  # of all together, 3k degrees of freedom


@dataclass(frozen=True)
class KinematicResult:
    """p parameters from s observations, and how far to believe them.

    With a robust loss the covariance is that of the weighted observations.
    """

    problem: KinematicProblem
    values: Floats  # (p,) in the order and units of problem.names and problem.units
    covariance: Floats  # (p, p)
    weighted: Floats  # (p, p) the part of it that the weights stand for, (Phi_k' W Phi_k)^-1
    residuals: Floats  # (s, 3) observed minus predicted [m, m, rad]
    weights: Floats  # (s,) of the loss: 1, or less for an observation far off
    chi_square: float  # weighted sum of squared residuals
    condition_number: float  # of the column-scaled regressor
    iterations: int
    last_update: float  # largest change in the last iteration, in the parameter's deviations
    converged: bool
    undetermined: tuple[str, ...] = ()  # parameters that the observations cannot tell apart
    missing: int = 0  # combinations of them that are undetermined

    @property
    def deviations(self) -> Floats:
        """(p,) 1 sigma of each parameter."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def degrees_of_freedom(self) -> int:
        """3s - p."""
        return self.residuals.size - self.values.size

    @property
    def position_residual(self) -> float:
        """Standard deviation of the 2s position residuals: root mean square about zero [m]."""
        return root_mean_square(self.residuals[:, :2])

    @property
    def heading_residual(self) -> float:
        """Standard deviation of the s heading residuals: root mean square about zero [rad]."""
        return root_mean_square(self.residuals[:, 2])

    def _spread(self, problem: KinematicProblem, covariance: Floats) -> Floats:
        """(s, 3, 3) what the parameters' covariance makes of predictions, in deviations."""
        Phi = problem.regressor(self.values).reshape(-1, 3, len(self.values))
        return np.asarray(Phi @ covariance @ np.swapaxes(Phi, 1, 2))

    @property
    def left(self) -> Left | None:
        """What the residuals of positions and headings tell of the deviations."""
        if self.undetermined:
            return None
        hat = np.diagonal(self._spread(self.problem, self.weighted), axis1=1, axis2=2)
        squares = self.weights[:, None] * self.problem.normalized(self.residuals) ** 2
        freedom = self.weights[:, None] * (1.0 - self.weights[:, None] * hat)
        parts = [np.array([np.sum(x[:, :2]), np.sum(x[:, 2])]) for x in (squares, freedom)]
        return Left(*parts)

    @cached_property
    def leverage(self) -> Floats:
        """(s,) how far an observation determines its own prediction, 0 to 1.

        The mean of its three diagonal elements of the hat matrix; p / 3s on average.
        """
        hat = self.weights * np.trace(self._spread(self.problem, self.weighted), axis1=1, axis2=2)
        return np.asarray(hat / 3.0)

    @cached_property
    def normalized_residuals(self) -> Floats:
        """(s,) lengths of the residuals by their own covariance, 1 - hat.

        The squares of correct ones are distributed as chi-square with 3 degrees of freedom.
        """
        hat = self.weights[:, None, None] * self._spread(self.problem, self.weighted)
        return _lengths(self.problem.normalized(self.residuals), np.eye(3) - hat)

    def predicted(self, problem: KinematicProblem) -> Prediction:
        """Predict observations that were not solved from."""
        residuals = problem.residuals(self.values)
        z, Phi = problem.normalized(residuals), problem.regressor(self.values)
        # z' (1 + Phi C Phi')^-1 z, by the matrix inversion lemma
        v, C = Phi.T @ z.ravel(), self.covariance
        chi_square = float(
            np.sum(z**2) - v @ np.linalg.solve(np.eye(len(v)) + C @ Phi.T @ Phi, C @ v)
        )
        return Prediction(residuals, _lengths(z, np.eye(3) + self._spread(problem, C)), chi_square)

    def calibrated(self) -> Arm:
        """The initial arm with the estimated parameters.

        Raises:
            DescriptionError: a length is not positive.
        """
        problem, arm = self.problem, self.problem.arm
        *values, theta_E = problem.all_parameters(self.values).tolist()
        cross = problem.basis @ problem.influence(self.values, self.weighted) @ problem.assumed
        C = problem.basis @ self.covariance @ problem.basis.T + problem.assumed - cross - cross.T
        uncertain = np.flatnonzero(np.diag(C) > 0.0)
        known = arm.known.told(
            [problem.all_names[k] for k in uncertain], C[np.ix_(uncertain, uncertain)]
        )
        return replace(arm.with_kinematics(values), theta_E=theta_E, known=known)


def _lengths(z: Floats, covariance: Floats) -> Floats:
    """sqrt(z' covariance^-1 z) of each, (s,), along the directions that have any."""
    inverse = np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
    return np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", z, inverse, z), 0.0))
