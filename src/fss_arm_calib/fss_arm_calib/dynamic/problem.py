"""Dynamic calibration: masses, centres of mass and inertias from the base's reaction (Eq. 6-10).

A maneuver consists of a path of the joints and of the base's poses at some marks before and after
it. With d of Eq. 6 (fss_arm_model.base_motion), the update

    Delta q_0f = q_0f observed - d(b, m, I, theta(t))                         (Eq. 7)
    Delta q_0f = Phi_d Delta xi_d                                             (Eq. 8)
    Delta xi_d = (Phi_d' W Phi_d)^-1 Phi_d' W Delta q_0f                      (Eq. 9)

is iterated. Each maneuver has its own unknowns, the pose and momentum at its start, which are
eliminated from its rows. The tilt of the table is one of the shared parameters. Headings are not
wrapped: a maneuver may turn the base by more than half a turn.

Prior knowledge enters in two ways. For an estimated parameter, it may be an additional observation
(a prior). For a parameter that is not estimated, it is an assumption: an error dc of the assumed
parameters, with regressor C, moves the estimate by P Phi_d' W C dc. The covariance includes this.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_pose_sensitivities, base_poses
from fss_arm_model.choice import Choice
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import Linear, eliminate, prior_regressor
from fss_arm_model.joint_path import Path
from fss_arm_model.parameters import bounds, to_vector, unit, values

TILT = ("g_x", "g_y")  # acceleration of a free body down the table, world axes


@dataclass(frozen=True)
class DynamicProblem:
    """Problem with M maneuvers of m marks each, and prior knowledge; deviations are 1 sigma."""

    path: Path  # M paths of the joints
    poses: Floats  # (M, m, 3) of the base at the marks [m, m, rad], headings not wrapped
    sigma: Floats  # (M, m, 3) standard deviations of the poses; inf: not observed
    arm: Arm  # the initial guess, and the values of assumed parameters
    choice: Choice  # the estimated parameters
    prior: Floats  # (c,) prior deviations of the estimated parameters; inf: no prior
    assumed: Floats  # (5 n + 6, 5 n + 6) covariance of all parameters; for estimated parameters,
    #                  only correlations of priors with each other and with assumed ones count
    momentum: Floats  # (3,) deviation of the initial momentum [N s, N s, N m s]; 0: at rest
    tilt: float = 0.0  # deviation of the table's tilt [m/s^2]; 0: level

    def __post_init__(self) -> None:
        shape = (len(self.path.nodes), self.path.marks.shape[-2], 3)
        for name, given in (("poses", self.poses.shape), ("sigma", self.sigma.shape)):
            if given != shape:
                raise ValueError(f"{name} has shape {given}, expected {shape}")
        if not np.isfinite(self.poses[np.isfinite(self.sigma)]).all():
            raise ValueError("a pose is not finite")
        if len(self.poses) and not np.isfinite(self.sigma[..., 2]).any():
            raise ValueError("no heading is observed")

    def select(self, which: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> "DynamicProblem":
        """Return the problem with only some of the maneuvers."""
        path = Path(*(part[which] for part in self.path))
        return replace(self, path=path, poses=self.poses[which], sigma=self.sigma[which])

    # The estimated parameters.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p estimated parameters: the choice, and the tilt if it is unknown."""
        return self.choice.names + (TILT if self.tilt > 0.0 else ())

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple(unit(name) for name in self.names)

    @cached_property
    def guess(self) -> Floats:
        """Initial values (p,): shared parameters are averaged, and the table is level."""
        x = self.choice.mean(values(self.arm))
        return np.pad(x, (0, len(self.names) - len(x)))

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds, (p,) each; a shared parameter meets the bounds of all members."""
        low, high = bounds(self.arm)
        members = self.choice.basis.T > 0.0
        free = np.full(len(self.names) - len(members), inf)
        low = np.where(members, low, -inf).max(axis=1)
        return np.append(low, -free), np.append(np.where(members, high, inf).min(axis=1), free)

    # Their priors, as rows of the regressor.

    @cached_property
    def prior_deviations(self) -> Floats:
        """Prior standard deviations (p,) of the initial values; inf: no prior."""
        return np.concatenate([self.prior, np.full(len(self.names) - len(self.prior), self.tilt)])

    @cached_property
    def prior_indices(self) -> npt.NDArray[np.intp]:
        """Indices (k,) of the parameters with a prior."""
        return np.flatnonzero(np.isfinite(self.prior_deviations))

    @cached_property
    def _prior_weights(self) -> Floats:
        """Matrix (k, 5 n + 6): each parameter with a prior as the mean of those that share it."""
        weights = (self.choice.basis / self.choice.basis.sum(axis=0)).T
        return np.pad(weights, ((0, len(self.names) - len(weights)), (0, 0)))[self.prior_indices]

    @cached_property
    def prior_rows(self) -> Floats:
        """Rows (k, p) of the regressor for the priors: the inverse root of their covariance."""
        sigma = self.prior_deviations[self.prior_indices]
        C = self._prior_weights @ self.assumed @ self._prior_weights.T
        C[np.diag_indices(len(C))] = sigma**2
        return prior_regressor(C, self.prior_indices, len(self.names))

    def prior_with(self, assumed: npt.NDArray[np.intp]) -> Floats:
        """Return the whitened covariance (k, c) of the priors' errors with assumed parameters."""
        between = self._prior_weights @ self.assumed[:, assumed]
        return np.asarray(self.prior_rows[:, self.prior_indices] @ between)

    # Unknowns: the parameters, then pose and momentum at the start of each maneuver.

    @cached_property
    def state_unknowns(self) -> npt.NDArray[np.intp]:
        """Indices (k,), 0 to 5, of initial pose and momentum that are unknowns of each maneuver."""
        seen = np.isfinite(self.sigma).any(axis=(0, 1))
        return np.flatnonzero(np.concatenate([seen, seen & (self.momentum > 0.0)]))

    @cached_property
    def prior_momenta(self) -> npt.NDArray[np.intp]:
        """Indices of the momentum components that are unknowns with a prior."""
        momenta = self.state_unknowns[self.state_unknowns >= 3] - 3
        return momenta[np.isfinite(self.momentum[momenta])]

    @cached_property
    def start(self) -> Floats:
        """Initial values of all unknowns: the guess, and each maneuver's first pose, at rest."""
        pose = self.poses[:, 0, :]
        first = np.concatenate([pose, np.zeros_like(pose)], axis=-1)[:, self.state_unknowns]
        return np.concatenate([self.guess, first.ravel()])

    # From the unknowns to the model: Arm.vector() and the states of base_motion.

    @cached_property
    def to_model(self) -> Floats:
        """Matrix (8 + 6 n + 8, p) from the parameters to Arm.vector() and base_motion's state."""
        chosen = to_vector(self.arm.n) @ self.choice.basis
        columns = np.zeros((len(chosen) + 8, len(self.names)))
        columns[: len(chosen), : chosen.shape[1]] = chosen
        if self.tilt > 0.0:
            columns[-2:, -2:] = np.eye(2)
        return columns

    @cached_property
    def uncertain(self) -> npt.NDArray[np.intp]:
        """Indices (c,) in parameter_names(n) of assumed parameters not known exactly."""
        uncertain = np.diag(self.assumed) > 0.0
        return np.flatnonzero(uncertain & ~self.choice.basis.any(axis=1))

    @cached_property
    def uncertain_to_model(self) -> Floats:
        """Matrix (8 + 6 n + 8, c) from these parameters to Arm.vector() and the state."""
        return np.pad(to_vector(self.arm.n)[:, self.uncertain], ((0, 8), (0, 0)))

    def vector(self, unknowns: Floats) -> Floats:
        """Return Arm.vector() (8 + 6 n,) with the estimated parameters in place of the guess."""
        chosen = self.choice.basis.any(axis=1) * values(self.arm)
        origin = self.arm.vector() - to_vector(self.arm.n) @ chosen
        return origin + unknowns[: len(self.names)] @ self.to_model[: len(origin)].T

    def states(self, unknowns: Floats) -> Floats:
        """Return the states (M, 8) of base_motion: initial pose and momentum, the table's tilt."""
        p, states = len(self.names), np.zeros((len(self.poses), 8))
        states[:, :3] = self.poses[:, 0, :]
        states[:, self.state_unknowns] = unknowns[p:].reshape(len(states), -1)
        if self.tilt > 0.0:
            states[:, 6:] = unknowns[p - 2 : p]
        return states

    # Residuals of the poses.

    @cached_property
    def observed_indices(self) -> npt.NDArray[np.intp]:
        """Indices of those of the 3 m pose coordinates that are observed in any maneuver."""
        return np.flatnonzero(np.isfinite(self.sigma).any(axis=0))

    @cached_property
    def weight(self) -> Floats:
        """Weights 1 / sigma of the observed coordinates, (M, rows)."""
        return 1.0 / self.sigma.reshape(len(self.sigma), -1)[:, self.observed_indices]

    def predict(self, unknowns: Floats) -> Floats:
        """Return the predicted poses at the marks, (M, m, 3)."""
        return base_poses(self.vector(unknowns), self.path, self.states(unknowns))

    def linearize(self, unknowns: Floats) -> Linear:
        """Linearize the problem in the p parameters, priors included."""
        linear = self.eliminate_states(unknowns, self.to_model)
        if not self.prior_indices.size:
            return linear
        off = self.prior_rows @ (self.guess - unknowns[: len(self.guess)])
        return linear._replace(
            residuals=np.concatenate([linear.residuals, off]),
            regressor=np.concatenate([linear.regressor, self.prior_rows]),
            cost=linear.cost + np.sum(off**2),
        )

    def eliminate_states(self, unknowns: Floats, columns: Floats) -> Linear:
        """Linearize the observations and eliminate each maneuver's own unknowns.

        `columns` (8 + 6 n + 8, c) maps the columns of the regressor to Arm.vector() and the state,
        as to_model does.
        """
        return self.linearize_at(self.vector(unknowns), self.states(unknowns), columns)

    def linearize_at(self, vector: Floats, states: Floats, columns: Floats) -> Linear:
        """Linearize as `eliminate_states` does, at an Arm.vector() and states (M, 8)."""
        poses, J = base_pose_sensitivities(vector, self.path, states)
        count = len(poses)
        rows = J.reshape(count, -1, J.shape[-1])[:, self.observed_indices] * self.weight[..., None]
        away = (self.poses - poses).reshape(count, -1)[:, self.observed_indices]
        r = np.where(self.weight > 0.0, away, 0.0) * self.weight
        A, B = rows @ columns, rows[..., len(vector) : -2][..., self.state_unknowns]
        if self.prior_momenta.size:
            sigma = self.momentum[self.prior_momenta]
            r = np.concatenate([r, -states[:, 3 + self.prior_momenta] / sigma], axis=-1)
            A = np.pad(A, ((0, 0), (0, sigma.size), (0, 0)))
            prior = np.eye(6)[3 + self.prior_momenta][:, self.state_unknowns] / sigma[:, None]
            B = np.concatenate([B, np.broadcast_to(prior, (count, *prior.shape))], axis=-2)
        return eliminate(A, B, r)

    @property
    def freedom_by_maneuver(self) -> npt.NDArray[np.intp]:
        """Number of observations of each maneuver, less its own unknowns, (M,)."""
        seen = np.isfinite(self.sigma).sum(axis=(1, 2))
        return np.asarray(seen + self.prior_momenta.size - self.state_unknowns.size)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of observations and priors, less the unknowns."""
        return int(self.freedom_by_maneuver.sum() + self.prior_indices.size - len(self.names))


@dataclass(frozen=True)
class ManeuverMeasurements:
    """Maneuvers in the joint estimate; unknown for each are its pose and momentum at the start."""

    problem: DynamicProblem

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates of the poses, less the unknowns without a prior."""
        return int(self.problem.freedom_by_maneuver.sum())

    def initial_unknowns(self) -> Floats:
        """Return the initial guess: each maneuver starts at rest at its first observed pose."""
        return self.problem.start[len(self.problem.names) :]

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the residuals of the base's poses, divided by their standard deviations."""
        problem, size = self.problem, layout.size(self.problem.arm.n)
        states = np.zeros((len(problem.poses), 8))
        states[:, :3] = problem.poses[:, 0]
        states[:, problem.state_unknowns] = unknowns.reshape(len(states), -1)
        states[:, 6:] = z[size : size + 2]
        columns = np.zeros((size + 8, len(z)))
        columns[:size, :size] = np.eye(size)
        columns[-2:, size : size + 2] = np.eye(2)
        return problem.linearize_at(z[:size], states, columns)
