"""Drift problem: effects of the table's tilt and of the hose while base and arm drift.

With the arm at rest, base and arm are one rigid body (fss_arm_model.drifting). All drifts share
the parameters of tilt and hose. Each drift has its own pose and twist at the start and its own
centre of mass. Errors of the masses scale torque and momentum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import (
    MAX_UNDETERMINED_SHARE,
    Decomposition,
    Linear,
    Mask,
    Minimum,
    minimize,
)
from fss_arm_calib.estimation.statistics import redundancy
from fss_arm_calib.segments.drifts import Drift
from fss_arm_model import drifting
from fss_arm_model.arrays import Floats
from fss_arm_model.drifting import SURROUNDINGS

NAMES = SURROUNDINGS
UNITS = ("m/s^2", "m/s^2", "N m", "N m s", "N s/m")
UNKNOWNS_PER_DRIFT = 8  # unknowns of each drift: pose, twist, centre of mass in the base

#: Half differences for numerical derivatives: far above rounding, with negligible curvature.
DIFFERENCE_STEPS = np.array(
    [1e-5, 1e-5, 3e-7, 1e-5, 1e-4, *[1e-3] * 3, 1e-4, 1e-4, 1e-5, *[1e-3] * 2]
)
ZERO_REDUNDANCY = 1e-9  # redundancy below which one drift alone determines a direction
TOLERANCE = 1e-4  # largest last update [deviations]; integration errors are smaller


def mean_motion(drift: Drift) -> Floats:
    """Return the first pose of a drift and its mean twist, (6,)."""
    first, last = np.array(drift.poses[0]), np.array(drift.poses[-1])
    return np.concatenate([first, (last - first) / (drift.times[-1] - drift.times[0])])


@dataclass(frozen=True)
class DriftProblem:
    """Problem with drifts and prior knowledge.

    Deviations are 1 sigma about 0; a deviation of 0 means that the value is 0.
    """

    drifts: Sequence[Drift]
    bodies: Floats  # (s, 4) base and arm as one body, see drifting.single_body
    sigma: Sequence[Floats]  # (m, 3) standard deviations of each drift's poses
    torque: float = 0.05  # deviation of the hose's torque at rest [N m]
    twist_damping: float = 0.01  # deviation of the hose's resistance to turning [N m s]
    drag: float = 0.05  # deviation of the hose's resistance to moving [N s/m]
    com: float = 0.01  # deviation of the centre of mass, each axis, about the described one [m]
    mass: float = 0.05  # relative deviation of mass and inertia

    @cached_property
    def start(self) -> Floats:
        """Initial values of all unknowns: no external effects, and each drift's mean twist."""
        parts: list[Floats] = [np.zeros(len(NAMES))]
        for drift, body in zip(self.drifts, self.bodies, strict=True):
            parts += [mean_motion(drift), body[2:]]
        return np.concatenate(parts)

    def motion(self, k: int, shared: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Return poses (c, m, 3) of drift k and its gain of spin K (omega_end - omega_start) (c,).

        Args:
            k: index of the drift.
            shared: (c, 5) shared parameters, a row for each set of unknowns.
            own: (c, 8) the drift's own unknowns.
        """
        body = np.empty((len(own), 4))
        body[:, :2], body[:, 2:] = self.bodies[k, :2], own[:, 6:]
        found = drifting.drift(body, shared, own[:, :6], np.array(self.drifts[k].times))
        return found[..., :3], self.bodies[k, 1] * (found[:, -1, 3] - own[:, 5])

    def derivatives(self, unknowns: Floats) -> list[tuple[Floats, Floats, float, Floats]]:
        """Return poses (m, 3), gain of spin and their derivatives by 13 unknowns, per drift."""
        found = []
        steps = DIFFERENCE_STEPS * np.vstack([np.zeros((1, 13)), np.eye(13), -np.eye(13)])
        for k in range(len(self.drifts)):
            own = unknowns[5 + UNKNOWNS_PER_DRIFT * k : 5 + UNKNOWNS_PER_DRIFT * (k + 1)]
            moved = np.concatenate([unknowns[:5], own]) + steps
            poses, gains = self.motion(k, moved[:, :5], moved[:, 5:])
            by = np.moveaxis(poses[1:14] - poses[14:], 0, -1) / (2.0 * DIFFERENCE_STEPS)
            gains_by = (gains[1:14] - gains[14:]) / (2.0 * DIFFERENCE_STEPS)
            found.append((poses[0], by, float(gains[0]), gains_by))
        return found

    def linearize(self, unknowns: Floats) -> Linear:
        """Linearize observations and priors, divided by their standard deviations."""
        residuals, rows = [], []
        for k, (poses, by, _, _) in enumerate(self.derivatives(unknowns)):
            weight = 1.0 / self.sigma[k].ravel()
            off = (np.array(self.drifts[k].poses) - poses).ravel() * weight
            every = np.column_stack([by.reshape(-1, 13) * weight[:, None], off])
            few: Floats = np.linalg.qr(every)[1]  # one row per column, without loss
            residuals.append(few[:, -1])
            J = np.zeros((len(few), len(unknowns)))
            J[:, :5] = few[:, :5]
            J[:, 5 + UNKNOWNS_PER_DRIFT * k : 5 + UNKNOWNS_PER_DRIFT * (k + 1)] = few[:, 5:13]
            rows.append(J)
        J, r = np.concatenate(rows), np.concatenate(residuals)
        known = self.prior_deviations
        J[:, known == 0.0] = 0.0
        with_prior = np.flatnonzero((known > 0.0) & np.isfinite(known))
        expected = np.concatenate([np.zeros(5), self.start[5:]])
        off = (expected - unknowns)[with_prior] / known[with_prior]
        J = np.concatenate([J, np.eye(len(unknowns))[with_prior] / known[with_prior, None]])
        r = np.concatenate([r, off])
        return Linear(r, J, r @ r)

    @cached_property
    def prior_deviations(self) -> Floats:
        """Prior standard deviations of all unknowns; inf: no prior."""
        none = [np.inf] * 6
        shared = [np.inf, np.inf, self.torque, self.twist_damping, self.drag]
        return np.array([*shared, *[*none, self.com, self.com] * len(self.drifts)])

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
class DriftResult:
    """Result of a drift calibration: external effects and initial momenta, with 1 sigma each."""

    problem: DriftProblem
    minimum: Minimum
    scatter: Floats = field(repr=False)  # covariance of all unknowns

    @property
    def values(self) -> Floats:
        """Values (5,) of the parameters NAMES in UNITS."""
        return self.minimum.x[:5]

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (5, 5), including the error of mass and inertia, which scales the forces."""
        scaled = np.concatenate([np.zeros(2), self.values[2:]]) * self.problem.mass
        return np.asarray(self.scatter[:5, :5] + np.outer(scaled, scaled))

    @cached_property
    def _predicted(self) -> list[tuple[Floats, Floats, float, Floats]]:
        return self.problem.derivatives(self.minimum.x)

    @property
    def _free(self) -> Mask:
        """Mask of the unknowns that are estimated and not at a bound."""
        return ~self.minimum.at_bound & (self.problem.prior_deviations > 0.0)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of external effects that the drifts do not separate."""
        lost = (self.minimum.basis.undetermined() > MAX_UNDETERMINED_SHARE) & self._free
        return tuple(compress(NAMES, lost))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of external effects that the drifts would make negative."""
        return tuple(compress(NAMES, self.minimum.at_bound))

    @property
    def missing(self) -> int:
        """Number of combinations of unknowns that are not determined."""
        return int(np.count_nonzero(self._free)) - len(self.minimum.basis.s)

    @property
    def condition_number(self) -> float:
        """Condition number of the column-scaled regressor of the estimated unknowns."""
        Phi = self.minimum.linear.regressor[:, self._free]
        return Decomposition.of(Phi).condition

    @cached_property
    def _hat(self) -> list[tuple[Floats, Floats]]:
        """Hat matrix and residuals of each drift, after elimination of its own unknowns."""
        linear, shared, found = self.minimum.linear, self.scatter[:5, :5], []
        for k in range(len(self.problem.drifts)):
            own = np.arange(5 + UNKNOWNS_PER_DRIFT * k, 5 + UNKNOWNS_PER_DRIFT * (k + 1))
            own = own[self.problem.prior_deviations[own] > 0.0]
            rows = np.flatnonzero(linear.regressor[:, own].any(axis=1))
            A, r = linear.regressor[rows, :5], linear.residuals[rows]
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
        free = [sigma.size - 6 for sigma in self.problem.sigma]
        inverses = [
            np.linalg.pinv(np.eye(len(r)) - H, ZERO_REDUNDANCY, hermitian=True)
            for H, r in self._hat
        ]
        squares = [r @ inverse @ r for inverse, (_, r) in zip(inverses, self._hat, strict=True)]
        errors = np.sqrt(np.array(squares) / free)
        controlled = np.array([redundancy(H[None])[0] for H, _ in self._hat])
        leverage = np.array([np.trace(H) for H, _ in self._hat])
        return CrossChecks(leverage, errors, controlled)

    @cached_property
    def residuals(self) -> list[Floats]:
        """Residuals (m, 3) of each drift, observed minus predicted [m, m, rad]."""
        pairs = zip(self.problem.drifts, self._predicted, strict=True)
        return [np.array(drift.poses) - poses for drift, (poses, *_) in pairs]

    @cached_property
    def hose_torque(self) -> tuple[float, float]:
        """Mean torque on base and arm about their centre of mass [N m], and 1 sigma.

        It is determined even if its constant part and its motion-dependent part are not.
        """
        total = sum(drift.times[-1] for drift in self.problem.drifts)
        by, mean = np.zeros(len(self.minimum.x)), 0.0
        for k, (_, _, gain, gain_by) in enumerate(self._predicted):
            mean += gain / total
            by[:5] += gain_by[:5] / total
            by[5 + UNKNOWNS_PER_DRIFT * k : 5 + UNKNOWNS_PER_DRIFT * (k + 1)] += gain_by[5:] / total
        variance = float(by @ self.scatter @ by) + (self.problem.mass * mean) ** 2
        return mean, float(np.sqrt(variance))

    @cached_property
    def momenta(self) -> tuple[Floats, Floats]:
        """Initial momenta (s, 3) and 1 sigma, (s, 3): linear [N s], angular [N m s].

        The angular momentum is about the centre of mass.
        """
        values, deviations = np.empty((2, len(self.problem.drifts), 3))
        for k, (mass, inertia, *_) in enumerate(self.problem.bodies.tolist()):
            at = slice(5 + UNKNOWNS_PER_DRIFT * k, 5 + UNKNOWNS_PER_DRIFT * (k + 1))
            _, _, theta, vx, vy, omega, cx, cy = self.minimum.x[at]
            turn = np.exp(1j * theta)
            lever = turn * complex(cx, cy)
            P = mass * (complex(vx, vy) + 1j * omega * lever)
            values[k] = P.real, P.imag, inertia * omega
            J = np.zeros((3, UNKNOWNS_PER_DRIFT))
            by = [-omega * lever, 1.0, 1j, 1j * lever, 1j * omega * turn, -omega * turn]
            J[:2, 2:] = mass * np.array([np.real(by), np.imag(by)])
            J[2, 5] = inertia
            variance = np.diag(J @ self.scatter[at, at] @ J.T)
            deviations[k] = np.sqrt(variance + (self.problem.mass * values[k]) ** 2)
        return values, deviations


def solve(problem: DriftProblem) -> DriftResult:
    """Solve for the external effects by least squares; resistances to motion are at least 0.

    The first solution is without resistances, so that the steps from a rough start are short.
    """
    plain = replace(problem, twist_damping=0.0, drag=0.0, com=0.0)
    x = problem.start
    for one in (plain, problem):
        low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
        low[3:5] = 0.0
        minimum = minimize(one.linearize, x, (low, high), TOLERANCE)
        x = minimum.x
    return DriftResult(problem, minimum, minimum.basis.covariance())
