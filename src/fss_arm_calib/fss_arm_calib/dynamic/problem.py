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

from fss_arm_calib.dynamic.parameters import Choice
from fss_arm_calib.estimation.least_squares import Floats, Linear, eliminate
from fss_arm_model.base_motion import base_pose_sensitivities, base_poses
from fss_arm_model.description import Arm
from fss_arm_model.joint_path import Path
from fss_arm_model.parameters import bounds, to_vector, unit, values

TILT = ("g_x", "g_y")  # acceleration of a free body down the table, world axes


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
        """Least and largest values, (p,) each, of all that a parameter stands for."""
        low, high = bounds(self.arm)
        members = self.choice.basis.T > 0.0
        free = np.full(len(self.names) - len(members), inf)
        low = np.where(members, low, -inf).max(axis=1)
        return np.append(low, -free), np.append(np.where(members, high, inf).min(axis=1), free)

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
