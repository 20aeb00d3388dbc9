"""Solver for the masses, centres of mass and inertias that fit best (Eq. 9), and its result."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, Known
from fss_arm_model.estimation.least_squares import Decomposition, Fit, minimize
from fss_arm_model.estimation.noise import ResidualSums
from fss_arm_model.estimation.statistics import redundancy
from fss_arm_model.parameters import parameter_names, values, with_values


@dataclass(frozen=True)
class DynamicResult(Fit):
    """Estimate of p parameters from M maneuvers, with its uncertainty."""

    problem: DynamicProblem

    @property
    def assumed_names(self) -> tuple[str, ...]:
        """Names of the assumed parameters not known exactly."""
        names = parameter_names(self.problem.arm.n)
        return tuple(names[k] for k in self.problem.uncertain)

    @property
    def assumed_deviations(self) -> Floats:
        """Standard deviations (c,) of the assumed parameters not known exactly."""
        return np.sqrt(np.diag(self.problem.assumed)[self.problem.uncertain])

    @cached_property
    def by_assumed(self) -> Floats:
        """Regressor C (rows, c) of the assumed parameters, weighted and reduced as the others."""
        problem = self.problem
        return problem.eliminate_states(self.minimum.x, problem.uncertain_to_model).regressor

    @cached_property
    def assumed_covariance(self) -> Floats:
        """Covariance (c, c) of the assumed parameters not known exactly."""
        return self.problem.assumed[np.ix_(self.problem.uncertain, self.problem.uncertain)]

    @cached_property
    def influence(self) -> Floats:
        """Shift (p, c) of the estimate per error (true - assumed) of each assumed parameter."""
        Phi = self.minimum.linear.regressor[: len(self.by_assumed)]
        return np.asarray(self.random @ (Phi.T @ self.by_assumed))

    @cached_property
    def bias(self) -> Floats:
        """Shift (p, c) of the estimate if a true value is 1 sigma above the assumed one."""
        return self.influence * self.assumed_deviations

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (p, p), including the uncertainty of the assumed parameters."""
        G, shared = self.influence, self._with_assumed @ self.influence.T
        return np.asarray(self.random + G @ self.assumed_covariance @ G.T - shared - shared.T)

    @cached_property
    def _with_assumed(self) -> Floats:
        """Covariance (p, c) of estimated and assumed parameters due to the priors alone."""
        rows, errors = self.problem.prior_rows, self.problem.prior_with(self.problem.uncertain)
        return np.asarray(self.random @ rows.T @ errors)

    @property
    def updated_knowledge(self) -> Known:
        """Knowledge of all parameters after the calibration, including the assumed ones."""
        basis, every = self.problem.choice.basis, parameter_names(self.problem.arm.n)
        size, assumed = basis.shape[1], self.assumed_covariance
        cross = (self._with_assumed - self.influence @ assumed)[:size]
        C = np.block([[self.covariance[:size, :size], cross], [cross.T, assumed]])
        J = np.concatenate([basis, np.eye(len(every))[:, self.problem.uncertain]], axis=1)
        uncertain = np.flatnonzero(J.any(axis=1))
        C = (J @ C @ J.T)[np.ix_(uncertain, uncertain)]
        return self.problem.arm.known.updated([every[k] for k in uncertain], C)

    @property
    def prior_share(self) -> Floats:
        """Share (p,) of each estimate that comes from the prior: the diagonal of P Lambda_prior."""
        rows = self.problem.prior_rows
        return np.diag(self.random @ rows.T @ rows)

    @cached_property
    def residuals(self) -> Floats:
        """Observed minus predicted poses (M, m, 3) [m, m, rad]; NaN where not observed."""
        away = self.problem.poses - self.problem.predict(self.minimum.x)
        return np.where(np.isfinite(self.problem.sigma), away, np.nan)

    @property
    def momenta(self) -> Floats:
        """Momentum (M, 3) at the start of each maneuver [N s, N s, N m s]."""
        return self.problem.states(self.minimum.x)[:, 3:6]

    @cached_property
    def _explained(self) -> tuple[Floats, Floats, Decomposition]:
        """Residuals, regressor and basis if assumed parameters may vary within their deviations.

        This is a first-order result. The rows of the priors follow those of the maneuvers.
        """
        linear, C = self.minimum.linear, self.by_assumed
        w, V = np.linalg.eigh(self.assumed_covariance)
        C = C @ (V * np.sqrt(np.maximum(w, 0.0)))
        rows = len(linear.residuals) - len(C)
        upper = np.concatenate([linear.regressor, np.pad(C, ((0, rows), (0, 0)))], axis=1)
        lower = np.eye(C.shape[1], upper.shape[1], len(self.values))
        A = np.concatenate([upper, lower])
        r = np.pad(linear.residuals, (0, len(lower)))
        basis = Decomposition.of(A)
        return r - A @ basis.step(r), A, basis

    @property
    def chi_square(self) -> float:
        """Weighted sum of squares, priors included, not explained by errors of assumed values."""
        return float(np.sum(self._explained[0] ** 2))

    @cached_property
    def _hat(self) -> tuple[Floats, Floats]:
        """Hat matrix of each maneuver, (M, rows, rows), and its residuals."""
        count, rows = len(self.problem.poses), len(self.by_assumed)
        r, A, basis = self._explained
        A, r = A[:rows].reshape(count, -1, A.shape[1]), r[:rows].reshape(count, -1, 1)
        return A @ basis.covariance() @ np.swapaxes(A, 1, 2), r

    @cached_property
    def checks(self) -> tuple[Floats, Floats]:
        """Leverage of each maneuver, and its error when predicted from the others, (M,) each.

        Let H be the maneuver's part of the hat matrix. Then r' (1 - H)^-1 r is the sum of squares
        of its errors, if it is held out and predicted from the others, in standard deviations of
        that prediction. The root mean square is about 1.
        """
        H, r = self._hat
        squares = (np.swapaxes(r, 1, 2) @ np.linalg.solve(np.eye(H.shape[1]) - H, r)).ravel()
        freedom = np.maximum(self.problem.freedom_by_maneuver, 1)
        return np.trace(H, axis1=1, axis2=2), np.sqrt(squares / freedom)

    @property
    def residual_sums(self) -> ResidualSums:
        """Squared residuals and degrees of freedom of positions and headings, without priors.

        The priors are left out, above all those of the momenta. Their deviations may be far larger
        than the momenta: then they add nothing to the sum of squares, but much to its degrees of
        freedom.
        """
        H, r = self._hat
        seen = self.problem.weight > 0.0
        rows = seen.shape[1]
        hat = np.diagonal(H, axis1=1, axis2=2) + self.minimum.linear.absorbed.reshape(len(seen), -1)
        free = seen - hat[:, :rows]
        heading = self.problem.observed_indices % 3 == 2
        kinds = np.array([~heading, heading]).astype(float)
        squares = np.sum(r[:, :rows, 0] ** 2, axis=0)
        return ResidualSums(kinds @ squares, kinds @ np.sum(free, axis=0))

    @property
    def redundancy(self) -> Floats:
        """Smallest share (M,) of a maneuver's error that shows in its residuals, squared."""
        return redundancy(self._hat[0])

    def calibrated(self) -> Arm:
        """Return the arm with the estimated parameters; DescriptionError: a value is impossible."""
        arm, basis = self.problem.arm, self.problem.choice.basis
        x = basis @ self.values[: basis.shape[1]]
        found = with_values(arm, np.where(basis.any(axis=1), x, values(arm)))
        return replace(found, known=self.updated_knowledge)


TOLERANCE = 1e-7  # largest last update [deviations]

STATE_ITERATIONS = 2  # first iterations, of only the maneuvers' own unknowns


def initial_unknowns(problem: DynamicProblem) -> Floats:
    """Return the initial unknowns: the guess, and the matching initial states of the maneuvers.

    The guess of a momentum is zero. If the base turned by radians more than this predicts, the
    first step of the parameters would diverge. So the maneuvers' own unknowns are updated first.
    """
    x = problem.start
    hold = np.zeros(len(problem.names))
    for _ in range(STATE_ITERATIONS if (problem.state_unknowns >= 3).any() else 0):
        extend = problem.linearize(x).extend
        x = x + extend(hold) if extend else x
    return x


def solve(
    problem: DynamicProblem, bounded: bool = True, tolerance: float = TOLERANCE
) -> DynamicResult:
    """Iterate Eq. 9 from the guess until the update is below `tolerance` [deviations].

    Parameters that are not identifiable stay as near to the guess as the others allow. The result
    names them. If `bounded`, parameters keep to problem.bounds; deviations are correct only if no
    bound is active.
    """
    bounds = problem.bounds if bounded else None
    start = initial_unknowns(problem)
    return DynamicResult(problem, minimize(problem.linearize, start, bounds, tolerance))
