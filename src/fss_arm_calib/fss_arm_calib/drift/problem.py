"""What acts on the base from outside: the table's tilt and the hose, while base and arm drift.

With the arm at rest they are one rigid body, as fss_arm_model.drifting has it. What acts on it is
shared by all drifts; pose and twist at its start, and the centre of mass, each has for its own. The
masses' errors scale torque and momentum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import (
    NOTICEABLE,
    Decomposition,
    Floats,
    Linear,
    Mask,
    Minimum,
    minimize,
)
from fss_arm_calib.estimation.statistics import redundancy
from fss_arm_calib.segments.drifts import Drift
from fss_arm_model import drifting
from fss_arm_model.description import Arm
from fss_arm_model.drifting import SURROUNDINGS

NAMES = SURROUNDINGS
UNITS = ("m/s^2", "m/s^2", "N m", "N m s", "N s/m")
OWN = 8  # unknowns of each drift: pose, twist, centre of mass in the base

#: Half the differences that derivatives are taken over: far above rounding, far below curvature.
STEPS = np.array([1e-5, 1e-5, 3e-7, 1e-5, 1e-4, *[1e-3] * 3, 1e-4, 1e-4, 1e-5, *[1e-3] * 2])
ALONE = 1e-9  # redundancy below which a drift alone determines something
TOLERANCE = 1e-4  # of the last update [deviations]; integration errs by less


class Body(NamedTuple):
    """Base and arm as one."""

    mass: float  # [kg]
    inertia: float  # about the centre of mass [kg m^2]
    com: complex  # in the base's frame [m]


def rigid_body(arm: Arm, q: Sequence[float]) -> Body:
    """The floating body that an arm is at joint readings q."""
    mass, inertia, *com = drifting.whole(arm.vector(), q)
    return Body(mass, inertia, complex(*com))


def begun(drift: Drift) -> Floats:
    """(6,) where a drift begins, and its mean twist."""
    first, last = np.array(drift.poses[0]), np.array(drift.poses[-1])
    return np.concatenate([first, (last - first) / (drift.times[-1] - drift.times[0])])


@dataclass(frozen=True)
class DriftProblem:
    """Drifts, and what is known beforehand; deviations are 1 sigma, about 0, 0: it is 0."""

    drifts: Sequence[Drift]
    bodies: Sequence[Body]
    sigma: Sequence[Floats]  # (m, 3) of each drift's poses
    torque: float = 0.05  # of the hose at rest [N m]
    twist_damping: float = 0.01  # of its resistance to turning [N m s]
    drag: float = 0.05  # and to moving [N s/m]
    com: float = 0.01  # of the centre of mass, each axis, about the description's [m]
    mass: float = 0.05  # of mass and inertia, relative

    @cached_property
    def start(self) -> Floats:
        """All unknowns at the begin: nothing acts, and each drift has its mean twist."""
        parts: list[Floats] = [np.zeros(len(NAMES))]
        for drift, body in zip(self.drifts, self.bodies, strict=True):
            parts += [begun(drift), np.array([body.com.real, body.com.imag])]
        return np.concatenate(parts)

    def motion(self, k: int, shared: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Poses (c, m, 3) of drift k, and its gain of spin K (omega_end - omega_start) (c,).

        Args:
            k: the drift.
            shared: (c, 5), a row for each set of unknowns.
            own: (c, 8).
        """
        body = np.empty((len(own), 4))
        body[:, :2], body[:, 2:] = self.bodies[k][:2], own[:, 6:]
        found = drifting.drift(body, shared, own[:, :6], np.array(self.drifts[k].times))
        return found[..., :3], self.bodies[k].inertia * (found[:, -1, 3] - own[:, 5])

    def derivatives(self, unknowns: Floats) -> list[tuple[Floats, Floats, float, Floats]]:
        """Of each drift: poses (m, 3), gain of spin, and their derivatives by 13 unknowns."""
        found = []
        steps = STEPS * np.vstack([np.zeros((1, 13)), np.eye(13), -np.eye(13)])
        for k in range(len(self.drifts)):
            own = unknowns[5 + OWN * k : 5 + OWN * (k + 1)]
            moved = np.concatenate([unknowns[:5], own]) + steps
            poses, gains = self.motion(k, moved[:, :5], moved[:, 5:])
            by = np.moveaxis(poses[1:14] - poses[14:], 0, -1) / (2.0 * STEPS)
            gains_by = (gains[1:14] - gains[14:]) / (2.0 * STEPS)
            found.append((poses[0], by, float(gains[0]), gains_by))
        return found

    def linearize(self, unknowns: Floats) -> Linear:
        """Observations and priors near some values, divided by their deviations."""
        residuals, rows = [], []
        for k, (poses, by, _, _) in enumerate(self.derivatives(unknowns)):
            weight = 1.0 / self.sigma[k].ravel()
            off = (np.array(self.drifts[k].poses) - poses).ravel() * weight
            every = np.column_stack([by.reshape(-1, 13) * weight[:, None], off])
            few: Floats = np.linalg.qr(every)[1]  # as many rows as columns hold the same
            residuals.append(few[:, -1])
            J = np.zeros((len(few), len(unknowns)))
            J[:, :5] = few[:, :5]
            J[:, 5 + OWN * k : 5 + OWN * (k + 1)] = few[:, 5:13]
            rows.append(J)
        J, r = np.concatenate(rows), np.concatenate(residuals)
        known = self.known
        J[:, known == 0.0] = 0.0
        believed = np.flatnonzero((known > 0.0) & np.isfinite(known))
        expected = np.concatenate([np.zeros(5), self.start[5:]])
        off = (expected - unknowns)[believed] / known[believed]
        J = np.concatenate([J, np.eye(len(unknowns))[believed] / known[believed, None]])
        r = np.concatenate([r, off])
        return Linear(r, J, r @ r)

    @cached_property
    def known(self) -> Floats:
        """Deviations of all unknowns before anything is observed; inf: nothing known."""
        none = [np.inf] * 6
        shared = [np.inf, np.inf, self.torque, self.twist_damping, self.drag]
        return np.array([*shared, *[*none, self.com, self.com] * len(self.drifts)])

    @property
    def degrees_of_freedom(self) -> int:
        """Observed coordinates less the unknowns of which nothing was known."""
        seen = sum(sigma.size for sigma in self.sigma)
        return seen - int(np.count_nonzero(np.isinf(self.known)))


@dataclass(frozen=True)
class DriftResult:
    """What acts from outside, and the momentum that each drift began with; 1 sigma beside each."""

    problem: DriftProblem
    minimum: Minimum
    scatter: Floats = field(repr=False)  # covariance of all unknowns

    @property
    def values(self) -> Floats:
        """(5,) NAMES in UNITS."""
        return self.minimum.x[:5]

    @cached_property
    def covariance(self) -> Floats:
        """(5, 5) with the error of mass and inertia, which forces and torques scale with."""
        scaled = np.concatenate([np.zeros(2), self.values[2:]]) * self.problem.mass
        return np.asarray(self.scatter[:5, :5] + np.outer(scaled, scaled))

    @cached_property
    def _predicted(self) -> list[tuple[Floats, Floats, float, Floats]]:
        return self.problem.derivatives(self.minimum.x)

    @property
    def _free(self) -> Mask:
        """Which of all unknowns are estimated and at no bound."""
        return ~self.minimum.held & (self.problem.known > 0.0)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of what acts from outside that the drifts cannot tell apart."""
        lost = (self.minimum.basis.undetermined() > NOTICEABLE) & self._free
        return tuple(compress(NAMES, lost))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of what acts from outside that the drifts would make negative."""
        return tuple(compress(NAMES, self.minimum.held))

    @property
    def missing(self) -> int:
        """Number of combinations of unknowns that are not determined."""
        return int(np.count_nonzero(self._free)) - len(self.minimum.basis.s)

    @property
    def condition_number(self) -> float:
        """Of the column-scaled regressor of the unknowns that are estimated."""
        Phi = self.minimum.linear.regressor[:, self._free]
        return Decomposition.of(Phi).condition

    @cached_property
    def _hat(self) -> list[tuple[Floats, Floats]]:
        """Each drift's part of the hat matrix, its own unknowns eliminated, and its residuals."""
        linear, shared, found = self.minimum.linear, self.scatter[:5, :5], []
        for k in range(len(self.problem.drifts)):
            own = np.arange(5 + OWN * k, 5 + OWN * (k + 1))
            own = own[self.problem.known[own] > 0.0]
            rows = np.flatnonzero(linear.regressor[:, own].any(axis=1))
            A, r = linear.regressor[rows, :5], linear.residuals[rows]
            Q = np.linalg.qr(linear.regressor[np.ix_(rows, own)])[0]
            A, r = A - Q @ (Q.T @ A), r - Q @ (Q.T @ r)
            found.append((A @ shared @ A.T, r))
        return found

    @property
    def checks(self) -> tuple[Floats, Floats, Floats]:
        """Of each drift against what the others say: leverage, error and redundancy, (s,) each.

        As in a dynamic calibration, its error is r' (1 - H)^-1 r, of which this is the root mean
        square of a coordinate. What a drift alone determines leaves no residual: nothing of it.
        """
        free = [sigma.size - 6 for sigma in self.problem.sigma]
        inverses = [np.linalg.pinv(np.eye(len(r)) - H, ALONE, hermitian=True) for H, r in self._hat]
        squares = [r @ inverse @ r for inverse, (_, r) in zip(inverses, self._hat, strict=True)]
        errors = np.sqrt(np.array(squares) / free)
        checked = np.array([redundancy(H[None])[0] for H, _ in self._hat])
        return np.array([np.trace(H) for H, _ in self._hat]), errors, checked

    @cached_property
    def residuals(self) -> list[Floats]:
        """(m, 3) of each drift, observed less predicted [m, m, rad]."""
        pairs = zip(self.problem.drifts, self._predicted, strict=True)
        return [np.array(drift.poses) - poses for drift, (poses, *_) in pairs]

    @cached_property
    def hose_torque(self) -> tuple[float, float]:
        """Mean torque on the whole about its centre of mass while it drifted [N m], and 1 sigma.

        What of it depends on the motion need not be told apart from what does not.
        """
        total = sum(drift.times[-1] for drift in self.problem.drifts)
        by, mean = np.zeros(len(self.minimum.x)), 0.0
        for k, (_, _, gain, gain_by) in enumerate(self._predicted):
            mean += gain / total
            by[:5] += gain_by[:5] / total
            by[5 + OWN * k : 5 + OWN * (k + 1)] += gain_by[5:] / total
        variance = float(by @ self.scatter @ by) + (self.problem.mass * mean) ** 2
        return mean, float(np.sqrt(variance))

    @cached_property
    def momenta(self) -> tuple[Floats, Floats]:
        """(s, 3) linear [N s] and, about the centre of mass, angular [N m s]; and 1 sigma."""
        values, deviations = np.empty((2, len(self.problem.drifts), 3))
        for k, body in enumerate(self.problem.bodies):
            at = slice(5 + OWN * k, 5 + OWN * (k + 1))
            _, _, theta, vx, vy, omega, cx, cy = self.minimum.x[at]
            turn = np.exp(1j * theta)
            lever = turn * complex(cx, cy)
            P = body.mass * (complex(vx, vy) + 1j * omega * lever)
            values[k] = P.real, P.imag, body.inertia * omega
            J = np.zeros((3, OWN))
            by = [-omega * lever, 1.0, 1j, 1j * lever, 1j * omega * turn, -omega * turn]
            J[:2, 2:] = body.mass * np.array([np.real(by), np.imag(by)])
            J[2, 5] = body.inertia
            variance = np.diag(J @ self.scatter[at, at] @ J.T)
            deviations[k] = np.sqrt(variance + (self.problem.mass * values[k]) ** 2)
        return values, deviations


def solve(problem: DriftProblem) -> DriftResult:
    """Least squares of what acts on the base; what resists motion is never below 0.

    It is left out at first, so that the steps from a rough start are short.
    """
    plain = replace(problem, twist_damping=0.0, drag=0.0, com=0.0)
    x = problem.start
    for one in (plain, problem):
        low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
        low[3:5] = 0.0
        minimum = minimize(one.linearize, x, (low, high), TOLERANCE)
        x = minimum.x
    return DriftResult(problem, minimum, minimum.basis.covariance())
