"""What a dynamic calibration finds, how far to believe it, and what it leaves over."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.estimation.least_squares import NOTICEABLE, Decomposition, Floats, Mask, Minimum
from fss_arm_calib.estimation.noise import Left
from fss_arm_calib.estimation.statistics import redundancy
from fss_arm_model.description import Arm, Known
from fss_arm_model.parameters import parameter_names, values, with_values


@dataclass(frozen=True)
class DynamicResult:
    """p parameters from M maneuvers, and how far to believe them."""

    problem: DynamicProblem
    minimum: Minimum

    @property
    def values(self) -> Floats:
        """(p,) in the order and units of problem.names and problem.units."""
        return self.minimum.x[: len(self.problem.names)]

    @cached_property
    def random(self) -> Floats:
        """(p, p) covariance by the errors of observations and priors alone."""
        return self.minimum.basis.covariance()

    @property
    def assumed(self) -> npt.NDArray[np.intp]:
        """(c,) indices, in parameter_names(n), of those assumed and not known exactly."""
        return self.problem.unsure

    @property
    def assumed_names(self) -> tuple[str, ...]:
        """Their names."""
        names = parameter_names(self.problem.arm.n)
        return tuple(names[k] for k in self.assumed)

    @property
    def assumed_deviations(self) -> Floats:
        """(c,) 1 sigma of them."""
        return np.sqrt(np.diag(self.problem.assumed)[self.assumed])

    @cached_property
    def by_assumed(self) -> Floats:
        """(rows, c) regressor C of the assumed parameters, weighted and reduced as the others."""
        return self.problem.reduced(self.minimum.x, self.problem.by_unsure).regressor

    @cached_property
    def influence(self) -> Floats:
        """(p, c) shift of the estimate by an error of each assumed parameter, true less assumed."""
        Phi = self.minimum.linear.regressor[: len(self.by_assumed)]
        return np.asarray(self.random @ (Phi.T @ self.by_assumed))

    @cached_property
    def bias(self) -> Floats:
        """(p, c) shift of the estimate if a true value is 1 sigma above the one assumed."""
        return self.influence * self.assumed_deviations

    @cached_property
    def covariance(self) -> Floats:
        """(p, p) with the uncertainty of what is assumed."""
        assumed = self.problem.assumed[np.ix_(self.assumed, self.assumed)]
        shared = self._with_assumed @ self.influence.T
        return np.asarray(
            self.random + self.influence @ assumed @ self.influence.T - shared - shared.T
        )

    @cached_property
    def _with_assumed(self) -> Floats:
        """(p, c) covariance that priors alone give the estimate's errors with the assumed ones."""
        return np.asarray(
            self.random @ self.problem.prior_rows.T @ self.problem.prior_with(self.assumed)
        )

    @property
    def known(self) -> Known:
        """What is known of all parameters now, those assumed included."""
        basis, every = self.problem.choice.basis, parameter_names(self.problem.arm.n)
        size, assumed = basis.shape[1], self.problem.assumed[np.ix_(self.assumed, self.assumed)]
        cross = (self._with_assumed - self.influence @ assumed)[:size]
        C = np.block([[self.covariance[:size, :size], cross], [cross.T, assumed]])
        J = np.concatenate([basis, np.eye(len(every))[:, self.assumed]], axis=1)
        uncertain = np.flatnonzero(J.any(axis=1))
        C = (J @ C @ J.T)[np.ix_(uncertain, uncertain)]
        return self.problem.arm.known.told([every[k] for k in uncertain], C)

    @cached_property
    def undetermined(self) -> Mask:
        """(p,) which parameters the data cannot tell from others."""
        return self.minimum.basis.undetermined() > NOTICEABLE

    @property
    def inseparable(self) -> tuple[str, ...]:
        """Names of parameters that the data cannot tell apart, those at a bound left out."""
        return tuple(compress(self.problem.names, self.undetermined & ~self.minimum.held))

    @property
    def condition_number(self) -> float:
        """Of the column-scaled regressor, priors included, parameters at a bound held."""
        Phi = self.minimum.linear.regressor[:, ~self.minimum.held]
        return Decomposition.of(Phi).condition if Phi.size else 1.0

    @cached_property
    def deviations(self) -> Floats:
        """(p,) 1 sigma of each parameter; inf where it is not determined."""
        return np.where(self.undetermined, inf, np.sqrt(np.diag(self.covariance)))

    @property
    def prior_share(self) -> Floats:
        """(p,) how much of each estimate came from what was known beforehand, 0 to 1.

        The diagonal of P Lambda_prior, 1 less the resolution of the data.
        """
        rows = self.problem.prior_rows
        return np.diag(self.random @ rows.T @ rows)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that the data would move out of their bounds."""
        return tuple(compress(self.problem.names, self.minimum.held))

    @cached_property
    def beyond_reach(self) -> tuple[str, ...]:
        """Names of those at a bound that their own errors may have taken there.

        They are known, bounds aside, to less than they are by the guess.
        """
        linear = self.minimum.linear
        free = Decomposition.of(linear.regressor)
        P, rows = free.covariance(), len(self.by_assumed)
        influence = P @ (linear.regressor[:rows].T @ self.by_assumed)
        assumed = self.problem.assumed[np.ix_(self.assumed, self.assumed)]
        deviations = np.sqrt(np.diag(P + influence @ assumed @ influence.T))
        away = np.abs(free.step(linear.residuals))
        guess, lost = np.abs(self.problem.guess), free.undetermined() > NOTICEABLE
        hidden = lost | ((away < 3.0 * deviations) & (deviations > 0.5 * guess))
        return tuple(compress(self.problem.names, hidden))

    @cached_property
    def residuals(self) -> Floats:
        """(M, m, 3) observed less predicted poses [m, m, rad]; NaN where not observed."""
        away = self.problem.poses - self.problem.predicted(self.minimum.x)
        return np.where(np.isfinite(self.problem.sigma), away, np.nan)

    @property
    def momenta(self) -> Floats:
        """(M, 3) momentum at each maneuver's start [N s, N s, N m s]."""
        return self.problem.states(self.minimum.x)[:, 3:6]

    @cached_property
    def _explained(self) -> tuple[Floats, Floats, Decomposition]:
        """Residuals and regressor with the assumed parameters free within their deviations.

        To first order; rows of the priors follow those of the maneuvers.
        """
        linear, C = self.minimum.linear, self.by_assumed
        w, V = np.linalg.eigh(self.problem.assumed[np.ix_(self.assumed, self.assumed)])
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
        """Weighted sum of squares, priors included, less what errors of assumed values explain."""
        return float(np.sum(self._explained[0] ** 2))

    @cached_property
    def _hat(self) -> tuple[Floats, Floats]:
        """Each maneuver's part of the hat matrix, (M, rows, rows), and its residuals."""
        count, rows = len(self.problem.poses), len(self.by_assumed)
        r, A, basis = self._explained
        A, r = A[:rows].reshape(count, -1, A.shape[1]), r[:rows].reshape(count, -1, 1)
        return A @ basis.covariance() @ np.swapaxes(A, 1, 2), r

    @cached_property
    def checks(self) -> tuple[Floats, Floats]:
        """Leverage and error of each maneuver, (M,) each, against what the others say.

        With the maneuver's part H of the hat matrix, r' (1 - H)^-1 r is the sum of squares of its
        errors if it is held out and predicted from the others, in the deviations of that
        prediction. Its root mean square is about 1.
        """
        H, r = self._hat
        squares = (np.swapaxes(r, 1, 2) @ np.linalg.solve(np.eye(H.shape[1]) - H, r)).ravel()
        return np.trace(H, axis1=1, axis2=2), np.sqrt(squares / np.maximum(self.problem.free, 1))

    @property
    def left(self) -> Left:
        """What the residuals of positions and headings tell of the deviations.

        Without what is known beforehand, of momenta above all, which may be far larger than they
        are: then it adds nothing to the sum of squares, and much to its degrees of freedom.
        """
        H, r = self._hat
        seen = self.problem.weight > 0.0
        rows = seen.shape[1]
        hat = np.diagonal(H, axis1=1, axis2=2) + self.minimum.linear.taken.reshape(len(seen), -1)
        free = seen - hat[:, :rows]
        heading = self.problem.looked_at % 3 == 2
        kinds = np.array([~heading, heading]).astype(float)
        return Left(kinds @ np.sum(r[:, :rows, 0] ** 2, axis=0), kinds @ np.sum(free, axis=0))

    @property
    def redundancy(self) -> Floats:
        """(M,) what share of an error of a maneuver shows in its residuals at least, squared."""
        return redundancy(self._hat[0])

    def calibrated(self) -> Arm:
        """The initial arm with the estimated parameters.

        Raises:
            DescriptionError: a value cannot be right.
        """
        arm, basis = self.problem.arm, self.problem.choice.basis
        x = basis @ self.values[: basis.shape[1]]
        found = with_values(arm, np.where(basis.any(axis=1), x, values(arm)))
        return replace(found, known=self.known)
