"""Dynamic calibration: masses, centres of mass and inertias from how the base reacts (Eq. 6-10).

A maneuver is a path of the joints and the base's poses at some marks before and after it. With d of
Eq. 6 (fss_arm_model.base_motion),

    Delta q_0f = q_0f observed - d(b, m, I, theta(t))                         (Eq. 7)
    Delta q_0f = Phi_d Delta xi_d                                             (Eq. 8)
    Delta xi_d = (Phi_d' W Phi_d)^-1 Phi_d' W Delta q_0f                      (Eq. 9)

is iterated. Each maneuver has unknowns of its own, the pose and momentum that it begins with, which
are eliminated from its rows; the tilt of the table is one of the shared parameters. Headings are
not wrapped: a maneuver may turn the base by more than half a turn.

What is known beforehand enters in two ways. Of estimated parameters it may be an observation of its
own (a prior). Of those that are not estimated it is an assumption: with C their regressor, an error
dc of theirs moves the estimate by P Phi_d' W C dc, which the covariance includes.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.parameters import Choice, parameter_names, to_vector, unit, values
from fss_arm_calib.estimation.least_squares import (
    Decomposition,
    Floats,
    Indices,
    Linear,
    Mask,
    Minimum,
    eliminate,
    minimize,
    minimize_all,
)
from fss_arm_calib.estimation.noise import Left
from fss_arm_calib.estimation.statistics import redundancy
from fss_arm_model.base_motion import Path, base_pose_sensitivities, base_poses
from fss_arm_model.description import Arm, Known
from fss_arm_model.parameters import with_values

TILT = ("g_x", "g_y")  # acceleration of a free body down the table, world axes

#: Beyond this condition number of the column-scaled regressor rounding has the say.
MAX_CONDITION = 1e6

DRAWS = 128  # that are solved side by side: as many as the processor's caches hold

FIRST = 2  # iterations of the maneuvers' own unknowns alone


@dataclass(frozen=True)
class DynamicProblem:
    """M maneuvers with m marks each, and what is known beforehand; deviations are 1 sigma.

    Raises:
        ValueError: an array has the wrong shape, or nothing is observed.
    """

    path: Path  # of the joints, M of them
    poses: Floats  # (..., M, m, 3) of the base at the marks [m, m, rad], headings counting turns;
    #                leading dimensions are a batch of draws, whose unknowns have them, too
    sigma: Floats  # (M, m, 3) their deviations; inf: not observed
    arm: Arm  # the initial guess, and the values of what is assumed
    choice: Choice  # what is estimated
    prior: Floats  # (c,) deviations of the guess of what is estimated; inf: nothing known
    assumed: Floats  # (5 n + 6, 5 n + 6) covariance of all parameters; of those estimated only
    #                  how their priors go with each other and with what is assumed
    momentum: Floats  # (3,) of the momentum at the start, about 0 [N s, N s, N m s]; 0: at rest
    tilt: float = 0.0  # of the table's tilt, about 0 [m/s^2]; 0: level

    def __post_init__(self) -> None:
        count = len(self.path.nodes)
        shape = (count, self.path.marks.shape[-2], 3)
        for name, given in (("poses", self.poses.shape[-3:]), ("sigma", self.sigma.shape)):
            if given != shape:
                raise ValueError(f"{name} has shape {given}, expected {shape}")
        if not np.isfinite(self.poses[..., np.isfinite(self.sigma)]).all():
            raise ValueError("a pose is not finite")
        if count and not np.isfinite(self.sigma[..., 2]).any():
            raise ValueError("no heading is observed")

    def scaled(self, factors: Floats) -> "DynamicProblem":
        """The same with other deviations of positions and headings, by factors (2,)."""
        return replace(self, sigma=self.sigma * factors[[0, 0, 1]])

    def seeing(self, poses: Floats) -> "DynamicProblem":
        """The same with other poses; what has been found of it and is not by them stays."""
        other = replace(self, poses=poses)
        kept = {name: x for name, x in vars(self).items() if name not in ("poses", "start")}
        vars(other).update(kept)
        return other

    def only(self, which: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> "DynamicProblem":
        """The same with some of the maneuvers."""
        path = Path(*(part[which] for part in self.path))
        return replace(self, path=path, poses=self.poses[which], sigma=self.sigma[which])

    @property
    def names(self) -> tuple[str, ...]:
        """The p parameters estimated: those chosen, and the tilt if the table may have one."""
        return self.choice.names + (TILT if self.tilt > 0.0 else ())

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple(unit(name) for name in self.names)

    @cached_property
    def own(self) -> npt.NDArray[np.intp]:
        """(k,) which of pose and momentum at its start, 0 to 5, each maneuver has as unknowns."""
        seen = np.isfinite(self.sigma).any(axis=(0, 1))
        return np.flatnonzero(np.concatenate([seen, seen & (self.momentum > 0.0)]))

    @cached_property
    def known(self) -> Floats:
        """(p,) deviations of the initial values; inf: nothing known."""
        return np.concatenate([self.prior, np.full(len(self.names) - len(self.prior), self.tilt)])

    @cached_property
    def believed(self) -> npt.NDArray[np.intp]:
        """(k,) which parameters have a prior."""
        return np.flatnonzero(np.isfinite(self.known))

    @cached_property
    def _pooled(self) -> Floats:
        """(k, 5 n + 6): parameters with a prior as means of those that they stand for."""
        weights = (self.choice.basis / self.choice.basis.sum(axis=0)).T
        return np.pad(weights, ((0, len(self.names) - len(weights)), (0, 0)))[self.believed]

    @cached_property
    def prior_rows(self) -> Floats:
        """(k, p) the priors as rows of a regressor: the inverse root of their covariance."""
        C, sigma = self._pooled @ self.assumed @ self._pooled.T, self.known[self.believed]
        C[np.diag_indices(len(C))] = sigma**2
        rows = np.zeros((len(C), len(self.names)))
        rows[:, self.believed] = np.linalg.inv(np.linalg.cholesky(C))
        return rows

    def prior_with(self, assumed: npt.NDArray[np.intp]) -> Floats:
        """(k, c) covariance of the priors' errors with those of assumed parameters, as rows are."""
        between = self._pooled @ self.assumed[:, assumed]
        return np.asarray(self.prior_rows[:, self.believed] @ between)

    @cached_property
    def guess(self) -> Floats:
        """(p,) initial values; unlike ones averaged where they count as one, a level table."""
        basis = self.choice.basis
        x = basis.T @ values(self.arm) / basis.sum(axis=0)
        return np.concatenate([x, np.zeros(len(self.names) - len(x))])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and largest values, (p,) each.

        Masses, inertias and lengths are above 0, centres of mass between the link's joints.
        """
        low = np.array([1e-6 if name[0] in "mIa" else -inf for name in self.names])
        high = np.full(len(low), inf)
        n, lengths = self.arm.n, np.array([link.a for link in self.arm.links])
        places = self.choice.basis[3 * n + 6 : 4 * n + 6].T  # (p, n) whose b each one is
        for k in np.flatnonzero(places.any(axis=1)):
            low[k], high[k] = 0.0, lengths[places[k] > 0.0].min()
        return low, high

    @cached_property
    def start(self) -> Floats:
        """All unknowns at the begin: the guess, and for each maneuver its first pose, at rest."""
        batch, pose = self.poses.shape[:-3], self.poses[..., 0, :]
        first = np.concatenate([pose, np.zeros_like(pose)], axis=-1)[..., self.own]
        guess = np.broadcast_to(self.guess, (*batch, self.guess.size))
        return np.concatenate([guess, first.reshape(*batch, -1)], axis=-1)

    @cached_property
    def to_model(self) -> Floats:
        """(8 + 6 n + 8, p): how the p parameters change Arm.vector() and base_motion's state."""
        chosen = to_vector(self.arm.n) @ self.choice.basis
        p = len(self.names)
        columns = np.zeros((len(chosen) + 8, p))
        columns[: len(chosen), : chosen.shape[1]] = chosen
        if self.tilt > 0.0:
            columns[-2:, -2:] = np.eye(2)
        return columns

    @cached_property
    def unsure(self) -> npt.NDArray[np.intp]:
        """(c,) indices, in parameter_names(n), of what is assumed and not known exactly."""
        uncertain = np.diag(self.assumed) > 0.0
        return np.flatnonzero(uncertain & ~self.choice.basis.any(axis=1))

    @cached_property
    def by_unsure(self) -> Floats:
        """(8 + 6 n + 8, c): how these change Arm.vector() and the state."""
        return np.pad(to_vector(self.arm.n)[:, self.unsure], ((0, 8), (0, 0)))

    @cached_property
    def origin(self) -> Floats:
        """(8 + 6 n,) Arm.vector() with the estimated parameters at 0."""
        chosen = self.choice.basis.any(axis=1) * values(self.arm)
        return self.arm.vector() - to_vector(self.arm.n) @ chosen

    def vector(self, unknowns: Floats) -> Floats:
        """Arm.vector() with the estimated parameters in place of the guess, (8 + 6 n,)."""
        size, p = len(self.origin), self.to_model.shape[1]
        return self.origin + unknowns[..., :p] @ self.to_model[:size].T

    def states(self, unknowns: Floats) -> Floats:
        """(M, 8) of base_motion: pose and momentum at the start, the table's tilt."""
        p = len(self.names)
        states = np.zeros((*self.poses.shape[:-2], 8))
        states[..., :3] = self.poses[..., 0, :]
        states[..., self.own] = unknowns[..., p:].reshape(*states.shape[:-1], self.own.size)
        if self.tilt > 0.0:
            states[..., 6:] = unknowns[..., None, p - 2 : p]
        return states

    def predicted(self, unknowns: Floats) -> Floats:
        """Poses at the marks, (M, m, 3)."""
        return base_poses(self.vector(unknowns)[..., None, :], self.path, self.states(unknowns))

    @cached_property
    def looked_at(self) -> npt.NDArray[np.intp]:
        """Which of the 3 m coordinates of poses are observed in any maneuver."""
        return np.flatnonzero(np.isfinite(self.sigma).any(axis=0))

    @cached_property
    def weight(self) -> Floats:
        """1 / sigma of those, (M, rows)."""
        return 1.0 / self.sigma.reshape(len(self.sigma), -1)[:, self.looked_at]

    @cached_property
    def moving(self) -> npt.NDArray[np.intp]:
        """Which components of the momentum are unknowns about which something is known."""
        momenta = self.own[self.own >= 3] - 3
        return momenta[np.isfinite(self.momentum[momenta])]

    def reduced(self, unknowns: Floats, columns: Floats) -> Linear:
        """The observations near some values, each maneuver's own unknowns eliminated.

        Args:
            unknowns: all of them.
            columns: (8 + 6 n + 8, c) what the regressor is by, as to_model.
        """
        return self.observed(self.vector(unknowns), self.states(unknowns), columns)

    def observed(self, vector: Floats, states: Floats, columns: Floats) -> Linear:
        """The same near an arm, Arm.vector(), and states (M, 8)."""
        poses, J = base_pose_sensitivities(vector[..., None, :], self.path, states)
        batch = poses.shape[:-2]  # of which the last are the maneuvers
        rows = J.reshape(*batch, -1, J.shape[-1])[..., self.looked_at, :] * self.weight[..., None]
        away = (self.poses - poses).reshape(*batch, -1)[..., self.looked_at]
        r = np.where(self.weight > 0.0, away, 0.0) * self.weight
        A, B = rows @ columns, rows[..., vector.shape[-1] : -2][..., self.own]
        if self.moving.size:
            sigma = self.momentum[self.moving]
            r = np.concatenate([r, -states[..., 3 + self.moving] / sigma], axis=-1)
            none = np.zeros((*batch, sigma.size, A.shape[-1]))
            A = np.concatenate([A, none], axis=-2)
            prior = np.eye(6)[3 + self.moving][:, self.own] / sigma[:, None]
            B = np.concatenate([B, np.broadcast_to(prior, (*batch, *prior.shape))], axis=-2)
        return eliminate(A, B, r)

    def linearize(self, unknowns: Floats) -> Linear:
        """The problem of the p parameters near some values, priors included."""
        linear = self.reduced(unknowns, self.to_model)
        if not self.believed.size:
            return linear
        batch, rows = linear.regressor.shape[:-2], self.prior_rows
        off = (rows @ (self.guess - unknowns[..., : len(self.guess)])[..., None])[..., 0]
        rows = np.broadcast_to(rows, (*batch, *rows.shape))
        return linear._replace(
            residuals=np.concatenate([linear.residuals, off], axis=-1),
            regressor=np.concatenate([linear.regressor, rows], axis=-2),
            cost=linear.cost + np.sum(off**2, axis=-1),
        )

    @property
    def free(self) -> npt.NDArray[np.intp]:
        """(M,) observations of each maneuver, less its own unknowns."""
        seen = np.isfinite(self.sigma).sum(axis=(1, 2))
        return np.asarray(seen + self.moving.size - self.own.size)

    @property
    def degrees_of_freedom(self) -> int:
        """Observations and priors less the unknowns."""
        return int(self.free.sum() + self.believed.size - len(self.names))


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
        return self.minimum.basis.undetermined() > 1e-6

    @property
    def inseparable(self) -> tuple[str, ...]:
        """Names of parameters that the data cannot tell apart, those at a bound left out."""
        pairs = zip(self.problem.names, self.undetermined, strict=True)
        return tuple(name for name, lost in pairs if lost and name not in self.at_bound)

    @property
    def condition_number(self) -> float:
        """Of the column-scaled regressor, priors included, parameters at a bound held."""
        Phi = self.minimum.linear.regressor[:, ~self.minimum.held]
        return Decomposition.of(Phi, MAX_CONDITION).condition if Phi.size else 1.0

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
        pairs = zip(self.problem.names, self.minimum.held, strict=True)
        return tuple(name for name, held in pairs if held)

    @cached_property
    def beyond_reach(self) -> tuple[str, ...]:
        """Names of those at a bound that their own errors may have taken there.

        They are known, bounds aside, to less than they are by the guess.
        """
        linear = self.minimum.linear
        free = Decomposition.of(linear.regressor, MAX_CONDITION)
        P, rows = free.covariance(), len(self.by_assumed)
        influence = P @ (linear.regressor[:rows].T @ self.by_assumed)
        assumed = self.problem.assumed[np.ix_(self.assumed, self.assumed)]
        deviations = np.sqrt(np.diag(P + influence @ assumed @ influence.T))
        away = np.abs(free.step(linear.residuals))
        guess, lost = np.abs(self.problem.guess), free.undetermined() > 1e-6
        hidden = lost | ((away < 3.0 * deviations) & (deviations > 0.5 * guess))
        return tuple(n for n, one in zip(self.problem.names, hidden, strict=True) if one)

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
        basis = Decomposition.of(A, MAX_CONDITION)
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


def underway(problem: DynamicProblem) -> Floats:
    """The unknowns to begin with: the guess, and what each maneuver then must have begun with.

    The guess of a momentum is rest. Were the base to turn by radians more than that, the first step
    of the parameters would lead far astray.
    """
    x = problem.start
    hold = np.zeros((*x.shape[:-1], len(problem.names)))
    for _ in range(FIRST if (problem.own >= 3).any() else 0):
        extend = problem.linearize(x).extend
        x = x + extend(hold) if extend else x
    return x


def solve(problem: DynamicProblem, bounded: bool = True, tolerance: float = 1e-7) -> DynamicResult:
    """Iterate Eq. 9 from the guess.

    Parameters that the data cannot tell apart stay as near to the guess as the others allow; the
    result names them.

    Args:
        problem: the maneuvers and what is known.
        bounded: keep to problem.bounds; deviations are true where none is active.
        tolerance: the update below which it has converged, in the parameter's deviations.
    """
    return DynamicResult(
        problem,
        minimize(
            problem.linearize,
            underway(problem),
            problem.bounds if bounded else None,
            tolerance=tolerance,
            max_condition=MAX_CONDITION,
        ),
    )


def solve_all(
    problem: DynamicProblem, poses: Floats, bounded: bool = True, tolerance: float = 1e-7
) -> list[DynamicResult]:
    """What `solve` finds of each of many draws of the poses, (N, M, m, 3), as in a Monte Carlo."""
    found = []
    for begin in range(0, len(poses), DRAWS):
        # By the last ones: what has been found of the problem stays found.
        some = problem = problem.seeing(poses[begin : begin + DRAWS])

        def linearize(x: Floats, which: Indices, some: DynamicProblem = some) -> Linear:
            return some.seeing(some.poses[which]).linearize(x)

        minima = minimize_all(
            linearize,
            underway(some),
            some.bounds if bounded else None,
            tolerance=tolerance,
            max_condition=MAX_CONDITION,
        )
        for one, minimum in zip(some.poses, minima, strict=True):
            own = some.seeing(one)
            found.append(DynamicResult(own, minimum) if minimum else solve(own, bounded, tolerance))
    return found


def information(problem: DynamicProblem, unknowns: npt.ArrayLike | None = None) -> Floats:
    """Phi' W Phi of the observations alone, priors left out, each maneuver's own unknowns gone.

    Returns:
        (M, p + c, p + c), by the parameters and what is assumed, for each maneuver: they add up.
    """
    x = problem.start if unknowns is None else np.asarray(unknowns, dtype=float)
    columns = np.concatenate([problem.to_model, problem.by_unsure], axis=1)
    Phi = problem.reduced(x, columns).regressor
    Phi = Phi.reshape(len(problem.poses), -1, columns.shape[1])
    return np.asarray(np.swapaxes(Phi, 1, 2) @ Phi)


def propagated(problem: DynamicProblem, total: Floats) -> Floats:
    """Covariance (..., p, p) of what would be estimated, with the uncertainty of what is assumed.

    Args:
        problem: what is estimated, and known beforehand.
        total: (..., p + c, p + c) information of all observations; with the priors it is regular.
    """
    p, rows, S = len(problem.names), problem.prior_rows, problem.unsure
    random = np.linalg.inv(total[..., :p, :p] + rows.T @ rows)
    influence = random @ total[..., :p, p:]
    shared = random @ (rows.T @ problem.prior_with(S)) @ np.swapaxes(influence, -1, -2)
    moved = influence @ problem.assumed[np.ix_(S, S)] @ np.swapaxes(influence, -1, -2)
    return np.asarray(random + moved - shared - np.swapaxes(shared, -1, -2))
