"""Joint problem: one arm from the rests, maneuvers and drifts of many sessions.

The method is maximum likelihood. The unknowns are x of the arm, shared by all sessions; y_s of each
session, in which tilt, hose and the joints' zeros are constant; and w_d of each datum, such as its
pose and momentum at the start. Let e be the errors of the observations divided by their standard
deviations, with unit covariance. Then

    e = r - A dx - B_s dy_s - C_d dw_d

so the regressor is a block arrowhead matrix. The w_d are eliminated from the rows of their datum,
then the y_s from those of their session, each by an orthogonal projection
(fss_arm_model.estimation). p + 1 rows of each session remain, so time and memory grow linearly with
the number of sessions. Back substitution then gives dy_s and dw_d from dx. The covariance of x
includes the uncertainty of all other unknowns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.calibration import Measurements
from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.drifting import SURROUNDINGS
from fss_arm_model.estimation.least_squares import (
    Decomposition,
    Fit,
    Linear,
    compress_rows,
    eliminate,
    minimize,
    prior_regressor,
)
from fss_arm_model.parameters import bounds, parameter_names, to_vector, unit, values, with_values

TOLERANCE = 1e-5  # largest last update [deviations]; numerical derivatives have smaller errors
DATA_ITERATIONS = 2  # first iterations, of only the data's own unknowns


class LinearizedData(NamedTuple):
    """Linearized data of one kind in a session, and the slice of their own unknowns."""

    kind: str
    linear: Linear  # in z
    unknowns: slice  # within all unknowns


@dataclass(frozen=True)
class JointProblem:
    """Joint problem of S sessions with measurements by kind and prior knowledge.

    Deviations are 1 sigma. The joints' zeros are those of the last session; earlier sessions have
    offsets relative to it.
    """

    arm: Arm  # the initial guess
    sessions: Sequence[Mapping[str, Measurements]]
    prior: Floats  # (p, p) covariance of the guess
    prior_indices: npt.NDArray[np.intp]  # indices of the parameters that have a prior
    surroundings: Floats  # (5,) deviations of SURROUNDINGS, about 0; 0: no such effect
    zeros: float = 0.0  # deviation of a joint's zero between sessions [rad]; 0: constant zeros
    theta_e: bool = False  # estimate the heading offset of the end effector's subject, too

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the p parameters of the arm."""
        return parameter_names(self.arm.n) + (("theta_E",) if self.theta_e else ())

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple(unit(name) for name in self.names)

    @cached_property
    def guess(self) -> Floats:
        """Initial values (p,) of the arm's parameters."""
        return np.array([*values(self.arm), *([self.arm.theta_E] if self.theta_e else [])])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds, (p,) each."""
        low, high = bounds(self.arm)
        free = np.full(len(self.names) - len(low), inf)
        return np.append(low, -free), np.append(high, free)

    @cached_property
    def _size(self) -> int:
        return layout.size(self.arm.n)

    @cached_property
    def by_arm(self) -> Floats:
        """Derivative (8 + 6 n + 5, p) of z by the arm's parameters."""
        T = np.zeros((self._size + len(SURROUNDINGS), len(self.names)))
        T[: self._size, : 5 * self.arm.n + 6] = to_vector(self.arm.n)
        if self.theta_e:
            T[layout.TIP_ANGLE, -1] = 1.0
        return T

    def session_names(self, session: int) -> tuple[str, ...]:
        """Return the names of a session's own parameters: zeros, but of the last, and effects."""
        zeros = [*parameter_names(self.arm.n)[4 + self.arm.n : 3 + 2 * self.arm.n], "theta_BJ1"]
        moved = zeros if self.zeros > 0.0 and session < len(self.sessions) - 1 else []
        acting = zip(SURROUNDINGS, self.surroundings, strict=True)
        return (*moved, *(name for name, sigma in acting if sigma > 0.0))

    def session_deviations(self, session: int) -> Floats:
        """Return the prior standard deviations of a session's own parameters, about 0."""
        sigma = dict(zip(SURROUNDINGS, self.surroundings.tolist(), strict=True))
        return np.array([sigma.get(name, self.zeros) for name in self.session_names(session)])

    def by_session(self, session: int) -> Floats:
        """Return the derivative (8 + 6 n + 5, k) of z by a session's own parameters."""
        names = self.session_names(session)
        T, every = np.zeros((self._size + len(SURROUNDINGS), len(names))), list(self.names)
        for k, name in enumerate(names):
            if name in SURROUNDINGS:
                T[self._size + SURROUNDINGS.index(name), k] = 1.0
            else:
                T[:, k] = self.by_arm[:, every.index(name)]
        return T

    @cached_property
    def _places(self) -> list[tuple[slice, dict[str, slice]]]:
        """Slices of the unknowns of each session, and of its data by kind, among all unknowns."""
        at, found = len(self.names), []
        for k, session in enumerate(self.sessions):
            own = slice(at, at := at + len(self.session_names(k)))
            data = {}
            for kind, measured in session.items():
                data[kind] = slice(at, at := at + len(measured.initial_unknowns()))
            found.append((own, data))
        return found

    def session_slice(self, session: int) -> slice:
        """Return the slice of a session's own parameters among all unknowns."""
        return self._places[session][0]

    def start(self, moved: Sequence[Floats] = (), arm: Floats | None = None) -> Floats:
        """Return initial values of all unknowns; those of the data are fitted to the others.

        Each session's own parameters are `moved`, by default 0; the parameters (p,) of the arm are
        by default the guess.
        """
        parts = [self.guess if arm is None else arm]
        for k, session in enumerate(self.sessions):
            parts.append(moved[k] if moved else np.zeros(len(self.session_names(k))))
            parts += [measured.initial_unknowns() for measured in session.values()]
        x = np.concatenate(parts)
        for _ in range(DATA_ITERATIONS):
            for k in range(len(self.sessions)):
                for _, linear, own in self.parts(x, k):
                    x[own] = x[own] + _data_step(linear, np.zeros(len(self.by_arm)))
        return x

    def z(self, x: Floats, session: int) -> Floats:
        """Return z, the quantities that a session's data depend on besides their own unknowns."""
        z = self.by_arm @ (x[: len(self.names)] - self.guess)
        z[: self._size] += self.arm.vector()
        return np.asarray(z + self.by_session(session) @ x[self.session_slice(session)])

    def parts(self, x: Floats, session: int) -> list[LinearizedData]:
        """Linearize a session's data, by kind."""
        z, found = self.z(x, session), []
        for kind, one in self.sessions[session].items():
            own = self._places[session][1][kind]
            found.append(LinearizedData(kind, one.linearize(z, x[own]), own))
        return found

    def rows(
        self, x: Floats, session: int, parts: Sequence[LinearizedData]
    ) -> tuple[Floats, Floats, Floats]:
        """Return a session's regressors by the arm's and by its own parameters, and residuals."""
        own, sigma = x[self.session_slice(session)], self.session_deviations(session)
        none = np.zeros((0, len(self.by_arm)))
        R = np.concatenate([*(part.linear.regressor for part in parts), none])
        r = np.concatenate([*(part.linear.residuals for part in parts), -own / sigma])
        A = np.concatenate([R @ self.by_arm, np.zeros((len(sigma), len(self.names)))])
        return A, np.concatenate([R @ self.by_session(session), np.diag(1.0 / sigma)]), r

    @property
    def prior_deviations(self) -> Floats:
        """Prior standard deviations (p,) of the guess; inf: no prior."""
        sigma = np.full(len(self.names), inf)
        sigma[self.prior_indices] = np.sqrt(np.diag(self.prior)[self.prior_indices])
        return sigma

    @cached_property
    def prior_rows(self) -> Floats:
        """Rows (k, p) of the regressor for the priors: the inverse root of their covariance."""
        which = self.prior_indices
        return prior_regressor(self.prior[np.ix_(which, which)], which, len(self.names))

    def linearize(self, x: Floats, without: str = "") -> Linear:
        """Linearize the problem in the p parameters of the arm, `without` the data of a kind."""
        p, cost, few, found = len(self.names), np.zeros(()), [], []
        for k in range(len(self.sessions)):
            parts = [part for part in self.parts(x, k) if part.kind != without]
            A, B, r = self.rows(x, k, parts)
            reduced = eliminate(A[None], B[None], r[None])
            few.append(compress_rows(np.column_stack([reduced.regressor, reduced.residuals])))
            found.append((k, parts, reduced))
            cost = cost + np.sum(r[len(r) - len(B.T) :] ** 2)
            cost = cost + sum(one.linear.cost for one in parts)
        off = self.prior_rows @ (self.guess - x[:p])
        rows = np.concatenate([*few, np.column_stack([self.prior_rows, off])])

        def extend(dx: Floats) -> Floats:
            steps = [dx]
            for k, parts, reduced in found:
                dy = _data_step(reduced, dx)
                dz = self.by_arm @ dx + self.by_session(k) @ dy
                steps += [dy, *(_data_step(linear, dz) for _, linear, _ in parts)]
            return np.concatenate(steps)

        return Linear(rows[:, p], rows[:, :p], cost + off @ off, extend)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of data in the sessions."""
        return tuple(dict.fromkeys(kind for session in self.sessions for kind in session))

    @property
    def degrees_of_freedom(self) -> int:
        """Number of observations and priors, less the unknowns; those of sessions have priors."""
        every = [one for session in self.sessions for one in session.values()]
        observed = sum(one.degrees_of_freedom for one in every)
        return observed + len(self.prior_indices) - len(self.names)


def _data_step(linear: Linear, dz: Floats) -> Floats:
    """Return the step of the data's own unknowns for a step dz."""
    assert linear.extend is not None
    return linear.extend(dz)[len(dz) :]


@dataclass(frozen=True)
class JointResult(Fit):
    """Estimate of the arm's p parameters and of each session's own, with the uncertainty."""

    problem: JointProblem

    def session(self, k: int) -> tuple[Floats, Floats]:
        """Return values and standard deviations of a session's own parameters."""
        problem, x = self.problem, self.minimum.x
        A, B, _ = problem.rows(x, k, problem.parts(x, k))
        by_arm = np.linalg.lstsq(B, A)[0]
        C = np.linalg.inv(B.T @ B) + by_arm @ self.covariance @ by_arm.T
        return x[problem.session_slice(k)], np.sqrt(np.diag(C))

    @cached_property
    def fits(self) -> dict[str, tuple[float, int]]:
        """Sum of squared residuals, and observations less own unknowns, for each kind of data."""
        found = dict.fromkeys(self.problem.kinds, (0.0, 0))
        for k, session in enumerate(self.problem.sessions):
            for kind, linear, _ in self.problem.parts(self.minimum.x, k):
                cost, freedom = found[kind]
                freedom += session[kind].degrees_of_freedom
                found[kind] = cost + float(linear.cost), freedom
        return found

    @cached_property
    def without(self) -> dict[str, Floats]:
        """Standard deviations (p,) without the data of each kind; inf: not determined."""
        found = {}
        for kind in self.problem.kinds:
            basis = Decomposition.of(self.problem.linearize(self.minimum.x, kind).regressor)
            found[kind] = np.where(basis.lost(), inf, np.sqrt(np.diag(basis.covariance())))
        return found

    def calibrated(self) -> Arm:
        """Return the arm with all estimates; DescriptionError: a value is impossible."""
        problem, size = self.problem, 5 * self.problem.arm.n + 6
        arm = with_values(problem.arm, self.values[:size])
        theta_E = float(self.values[-1]) if problem.theta_e else arm.theta_E
        known = arm.known.updated(problem.names, self.covariance)
        return replace(arm, theta_E=theta_E, known=known)


def solve(problem: JointProblem, start: Floats | None = None, bounded: bool = True) -> JointResult:
    """Solve for the most probable values of all unknowns, from problem.start() by default.

    If `bounded`, keep to problem.bounds; deviations are correct only if no bound is active.
    """
    begin = problem.start() if start is None else start
    bounds = problem.bounds if bounded else None
    return JointResult(problem, minimize(problem.linearize, begin, bounds, TOLERANCE))
