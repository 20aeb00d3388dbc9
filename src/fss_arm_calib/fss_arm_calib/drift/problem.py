"""Drift problem: effects of the table's tilt and of the hose while base and arm drift.

While the arm rests, base and arm are one rigid body (fss_arm_model.drifting). Its motion depends on

    5 shared unknowns: tilt of the table; torque, damping and drag of the hose (NAMES)
    8 unknowns of each drift: pose (3) and twist (3) at its start, centre of mass in the base (2)

and on mass and inertia. These are assumed here, so that their errors scale torque and momentum. In
the joint estimate (DriftMeasurements), the body follows from the arm's parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from fss_arm_calib.segments.drifts import Drift
from fss_arm_model import drifting, layout
from fss_arm_model.arrays import Floats
from fss_arm_model.drifting import (
    BODY_INDICES,
    SHARED_COUNT,
    STATE_COUNT,
    Sensitivity,
    sensitivities,
)
from fss_arm_model.estimation.least_squares import (
    Fit,
    Linear,
    Mask,
    compress_rows,
    eliminate,
    minimize,
)
from fss_arm_model.estimation.statistics import redundancy

NAMES = drifting.SURROUNDINGS
UNITS = ("m/s^2", "m/s^2", "N m", "N m s", "N s/m")
OWN_COUNT = STATE_COUNT + 2  # unknowns of one drift: pose and twist, centre of mass
BLOCK = SHARED_COUNT + OWN_COUNT + 1  # rows of one drift: compressed to its columns and residuals
ZERO_REDUNDANCY = 1e-9  # redundancy below which one drift alone determines a direction
TOLERANCE = 1e-4  # largest last update [deviations]; integration errors are smaller


def pose_rows(one: Sensitivity, drift: Drift) -> Floats:
    """Return the derivatives of all poses and, in the last column, residuals (m, 3, k + 1)."""
    off = np.array(drift.poses) - one.poses
    return np.concatenate([one.poses_by, off[..., None]], axis=-1)


def mean_motion(drift: Drift) -> Floats:
    """Return the first pose of a drift and its mean twist, (6,)."""
    first, last = np.array(drift.poses[0]), np.array(drift.poses[-1])
    return np.concatenate([first, (last - first) / (drift.times[-1] - drift.times[0])])


def own_unknowns(k: int) -> slice:
    """Return the slice of the unknowns of drift k among all unknowns."""
    return slice(SHARED_COUNT + OWN_COUNT * k, SHARED_COUNT + OWN_COUNT * (k + 1))


@dataclass(frozen=True)
class DriftProblem:
    """Problem with drifts and prior knowledge.

    Prior deviations are 1 sigma about 0, those of the centre of mass about the described one. A
    quantity with a deviation of 0 is not estimated; with a `mass` of 0, the masses are exact.
    """

    names: ClassVar = NAMES
    units: ClassVar = UNITS
    guess: ClassVar = np.zeros(SHARED_COUNT)
    drifts: Sequence[Drift]
    bodies: Floats  # (s, 4) base and arm as one body, see drifting.single_body
    sigma: Sequence[Floats]  # (m, 3) standard deviations of each drift's poses
    torque: float  # deviation of the hose's torque at rest [N m]
    twist_damping: float  # deviation of the hose's resistance to turning [N m s]
    drag: float  # deviation of the hose's resistance to moving [N s/m]
    com: float  # deviation of the centre of mass, each axis [m]
    mass: float  # relative deviation of mass and inertia

    @cached_property
    def start(self) -> Floats:
        """Initial values of all unknowns: no external effects, and each drift's mean twist."""
        pairs = zip(self.drifts, self.bodies, strict=True)
        own = [part for drift, body in pairs for part in (mean_motion(drift), body[2:])]
        return np.concatenate([np.zeros(SHARED_COUNT), *own])

    @cached_property
    def prior_deviations(self) -> Floats:
        """Prior standard deviations of all unknowns; inf: no prior."""
        shared = [np.inf, np.inf, self.torque, self.twist_damping, self.drag]
        return np.array(
            [*shared, *[*[np.inf] * STATE_COUNT, self.com, self.com] * len(self.drifts)]
        )

    def sensitivities(self, unknowns: Floats) -> list[Sensitivity]:
        """Return the motion of each drift, with its derivatives by shared and own unknowns."""
        return [
            sensitivities(
                drift.times,
                np.concatenate([unknowns[:SHARED_COUNT], unknowns[own_unknowns(k)], body[:2]]),
                SHARED_COUNT + OWN_COUNT,
            )
            for k, (drift, body) in enumerate(zip(self.drifts, self.bodies, strict=True))
        ]

    def linearize(self, unknowns: Floats) -> Linear:
        """Linearize observations and priors, divided by their standard deviations.

        Each drift has BLOCK rows, the last ones possibly 0; those of the priors follow.
        """
        residuals, regressors = [], []
        for k, one in enumerate(self.sensitivities(unknowns)):
            weighted = pose_rows(one, self.drifts[k]) * (1.0 / self.sigma[k])[..., None]
            rows = compress_rows(weighted.reshape(-1, weighted.shape[-1]))
            rows = np.pad(rows, ((0, BLOCK - len(rows)), (0, 0)))
            J = np.zeros((BLOCK, len(unknowns)))
            J[:, :SHARED_COUNT] = rows[:, :SHARED_COUNT]
            J[:, own_unknowns(k)] = rows[:, SHARED_COUNT:-1]
            regressors.append(J)
            residuals.append(rows[:, -1])
        sigma = self.prior_deviations
        known = np.flatnonzero((sigma > 0.0) & np.isfinite(sigma))
        priors = np.eye(len(unknowns))[known] / sigma[known, None]
        J = np.concatenate([*regressors, priors])
        J[:, sigma == 0.0] = 0.0
        r = np.concatenate([*residuals, (self.start - unknowns)[known] / sigma[known]])
        return Linear(r, J, r @ r)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of observed coordinates, less the unknowns without a prior."""
        seen = sum(sigma.size for sigma in self.sigma)
        return seen - int(np.count_nonzero(np.isinf(self.prior_deviations)))


class CrossChecks(NamedTuple):
    """Checks of each drift by the others, (s,) each."""

    leverage: Floats
    errors: Floats  # [deviations]
    redundancy: Floats


@dataclass(frozen=True)
class DriftResult(Fit):
    """Result of a drift calibration: external effects and initial momenta, with 1 sigma each.

    Its `random` is the covariance of all unknowns, not only of the shared ones.
    """

    problem: DriftProblem

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (5, 5), including the error of mass and inertia, which scales the forces."""
        scaled = np.concatenate([np.zeros(2), self.values[2:]]) * self.problem.mass
        return np.asarray(self.random[:SHARED_COUNT, :SHARED_COUNT] + np.outer(scaled, scaled))

    @cached_property
    def _predicted(self) -> list[Sensitivity]:
        return self.problem.sensitivities(self.minimum.x)

    @property
    def free(self) -> Mask:
        """Mask of the unknowns that are estimated and not at a bound."""
        return super().free & (self.problem.prior_deviations > 0.0)

    @cached_property
    def _hat(self) -> list[tuple[Floats, Floats]]:
        """Hat matrix and residuals of each drift, after elimination of its own unknowns."""
        linear, shared, found = self.minimum.linear, self.random[:SHARED_COUNT, :SHARED_COUNT], []
        for k in range(len(self.problem.drifts)):
            own = np.arange(len(self.minimum.x))[own_unknowns(k)]
            own = own[self.problem.prior_deviations[own] > 0.0]
            # Its block, with the row that contains only what no unknown explains, and its priors.
            in_block = np.arange(len(linear.residuals)) // BLOCK == k
            rows = np.flatnonzero(in_block | linear.regressor[:, own].any(axis=1))
            A, r = linear.regressor[rows, :SHARED_COUNT], linear.residuals[rows]
            Q = np.linalg.qr(linear.regressor[np.ix_(rows, own)])[0]
            A, r = A - Q @ (Q.T @ A), r - Q @ (Q.T @ r)
            found.append((A @ shared @ A.T, r))
        return found

    @property
    def cross_checks(self) -> CrossChecks:
        """Leverage, error and redundancy of each drift relative to the others.

        As in a dynamic calibration, r' (1 - H)^-1 r is the sum of squares of a drift's errors. The
        error here is its root mean square over the coordinates. Directions that only this drift
        determines leave no residual, so they do not contribute.
        """
        squares = [
            r @ np.linalg.pinv(np.eye(len(r)) - H, ZERO_REDUNDANCY, hermitian=True) @ r
            for H, r in self._hat
        ]
        free = [sigma.size - STATE_COUNT for sigma in self.problem.sigma]
        controlled = np.array([redundancy(H[None])[0] for H, _ in self._hat])
        leverage = np.array([np.trace(H) for H, _ in self._hat])
        return CrossChecks(leverage, np.sqrt(np.array(squares) / free), controlled)

    @cached_property
    def residuals(self) -> list[Floats]:
        """Residuals (m, 3) of each drift, observed minus predicted [m, m, rad]."""
        pairs = zip(self.problem.drifts, self._predicted, strict=True)
        return [np.array(drift.poses) - one.poses for drift, one in pairs]

    @cached_property
    def hose_torque(self) -> tuple[float, float]:
        """Mean torque on base and arm about their centre of mass [N m], and 1 sigma.

        It is determined even if its constant part and its motion-dependent part are not.
        """
        total = sum(drift.times[-1] for drift in self.problem.drifts)
        by, mean = np.zeros(len(self.minimum.x)), 0.0
        for k, one in enumerate(self._predicted):
            mean += one.spin / total
            by[:SHARED_COUNT] += one.spin_by[:SHARED_COUNT] / total
            by[own_unknowns(k)] += one.spin_by[SHARED_COUNT:] / total
        variance = float(by @ self.random @ by) + (self.problem.mass * mean) ** 2
        return mean, float(np.sqrt(variance))

    @cached_property
    def momenta(self) -> tuple[Floats, Floats]:
        """Initial momenta (s, 3) and 1 sigma, (s, 3): linear [N s], angular [N m s].

        The angular momentum is about the centre of mass.
        """
        values, deviations = np.empty((2, len(self.problem.drifts), 3))
        for k, (mass, inertia, *_) in enumerate(self.problem.bodies.tolist()):
            own = own_unknowns(k)
            _, _, theta, vx, vy, omega, cx, cy = self.minimum.x[own]
            turn = np.exp(1j * theta)
            lever = turn * complex(cx, cy)
            P = mass * (complex(vx, vy) + 1j * omega * lever)
            values[k] = P.real, P.imag, inertia * omega
            J = np.zeros((3, OWN_COUNT))
            by = [-omega * lever, 1.0, 1j, 1j * lever, 1j * omega * turn, -omega * turn]
            J[:2, 2:] = mass * np.array([np.real(by), np.imag(by)])
            J[2, 5] = inertia
            variance = np.diag(J @ self.random[own, own] @ J.T)
            deviations[k] = np.sqrt(variance + (self.problem.mass * values[k]) ** 2)
        return values, deviations


def solve(problem: DriftProblem) -> DriftResult:
    """Solve for the external effects by least squares; resistances to motion are at least 0.

    The first solution is without resistances, so that the steps from a rough start are short.
    """
    x = problem.start
    low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
    low[[NAMES.index("twist_damping"), NAMES.index("drag")]] = 0.0
    for one in (replace(problem, twist_damping=0.0, drag=0.0, com=0.0), problem):
        minimum = minimize(one.linearize, x, (low, high), TOLERANCE)
        x = minimum.x
    return DriftResult(problem, minimum)


@dataclass(frozen=True)
class DriftMeasurements:
    """Drifts in the joint estimate, of the arm's parameters and each drift's pose and twist."""

    drifts: Sequence[Drift]
    sigma: Sequence[Floats]  # (m, 3) standard deviations of each drift's poses
    n: int  # number of links

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates of the poses, less the drifts' own unknowns."""
        return sum(sigma.size - STATE_COUNT for sigma in self.sigma)

    def initial_unknowns(self) -> Floats:
        """Return the initial guess: each drift has its mean twist."""
        return np.concatenate([mean_motion(one) for one in self.drifts])

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the residuals of the base's poses, divided by their standard deviations.

        z (8 + 6 n + 5) is Arm.vector(), then NAMES; unknowns (6 s) are the poses and twists of the
        drifts at their starts.
        """
        size, q = layout.size(self.n), np.array([one.q for one in self.drifts])
        states = unknowns.reshape(-1, STATE_COUNT)
        bodies = drifting.single_body(z[:size], q)
        found = []
        for k, one in enumerate(self.drifts):
            mass, inertia, *com = bodies[k]
            u = np.array([*z[size:], *states[k], *com, mass, inertia])
            predicted = sensitivities(one.times, u, len(u))
            weighted = pose_rows(predicted, one) / self.sigma[k][..., None]
            found.append(compress_rows(weighted.reshape(-1, len(u) + 1)))
        rows = np.array(found)
        A = np.zeros((*rows.shape[:2], len(z)))
        A[..., size:] = rows[..., :SHARED_COUNT]
        A[..., :size] = rows[..., BODY_INDICES] @ drifting.single_body_sensitivities(z[:size], q)
        return eliminate(A, rows[..., SHARED_COUNT : SHARED_COUNT + STATE_COUNT], rows[..., -1])
