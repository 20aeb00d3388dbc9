"""One arm from rests, maneuvers and drifts of many sessions, by maximum likelihood.

The unknowns are those x of the arm, which all sessions share; those y_s of each session, in which
tilt, hose and the joints' zeros stay as they are; and those of each datum, as its pose and momentum
at the start. With e the observations divided by their deviations, of covariance 1,

    e = r - A dx - B_s dy_s - C_d dw_d

so the regressor is an arrow of blocks. The w_d are eliminated from the rows of their datum, then
the y_s from those of their session, each by an orthogonal projection (estimation.least_squares),
and p + 1 rows of each session remain: time and memory grow linearly with the number of sessions.
Then dy_s, dw_d follow from dx backwards. The covariance of x includes that of all others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.estimation.evidence import Evidence
from fss_arm_calib.estimation.least_squares import (
    NOTICEABLE,
    Decomposition,
    Floats,
    Linear,
    Minimum,
    eliminate,
    minimize,
)
from fss_arm_model import layout
from fss_arm_model.description import Arm
from fss_arm_model.drifting import SURROUNDINGS
from fss_arm_model.parameters import bounds, parameter_names, to_vector, unit, values, with_values

TOLERANCE = 1e-5  # of the last update [deviations]; differences as derivatives err by less
FIRST = 2  # iterations of the data's own unknowns alone


class Part(NamedTuple):
    """What a session's data of one kind say near some values, and where their unknowns stand."""

    kind: str
    linear: Linear  # by z
    own: slice  # of all unknowns


@dataclass(frozen=True)
class JointProblem:
    """Evidence of S sessions, by kind, and what is known beforehand; deviations are 1 sigma.

    The joints' zeros are those of the last session; before it they were off from that by so much.
    """

    arm: Arm  # the initial guess
    sessions: Sequence[Mapping[str, Evidence]]
    prior: Floats  # (p, p) covariance of the guess
    believed: npt.NDArray[np.intp]  # which parameters it is a prior of
    surroundings: Floats  # (5,) of SURROUNDINGS, about 0; 0: nothing acts
    zeros: float = 0.0  # of how far a joint's zero moves between sessions [rad]; 0: it does not
    theta_e: bool = False  # estimate the heading offset of the end effector's subject, too

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The p parameters of the arm."""
        return parameter_names(self.arm.n) + (("theta_E",) if self.theta_e else ())

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each."""
        return tuple(unit(name) for name in self.names)

    @cached_property
    def guess(self) -> Floats:
        """(p,) the arm's values."""
        return np.array([*values(self.arm), *([self.arm.theta_E] if self.theta_e else [])])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Least and largest values, (p,) each."""
        low, high = bounds(self.arm)
        free = np.full(len(self.names) - len(low), inf)
        return np.append(low, -free), np.append(high, free)

    @cached_property
    def _size(self) -> int:
        return layout.size(self.arm.n)

    @cached_property
    def by_arm(self) -> Floats:
        """(8 + 6 n + 5, p): how z changes with the arm's parameters."""
        T = np.zeros((self._size + len(SURROUNDINGS), len(self.names)))
        T[: self._size, : 5 * self.arm.n + 6] = to_vector(self.arm.n)
        if self.theta_e:
            T[layout.TIP_ANGLE, -1] = 1.0
        return T

    def own_names(self, session: int) -> tuple[str, ...]:
        """Parameters of a session's own: zeros, of all but the last, and what acts from outside."""
        zeros = [*parameter_names(self.arm.n)[4 + self.arm.n : 3 + 2 * self.arm.n], "theta_BJ1"]
        moved = zeros if self.zeros > 0.0 and session < len(self.sessions) - 1 else []
        acting = zip(SURROUNDINGS, self.surroundings, strict=True)
        return (*moved, *(name for name, sigma in acting if sigma > 0.0))

    def own_deviations(self, session: int) -> Floats:
        """What is known of them beforehand: 0 is expected."""
        sigma = dict(zip(SURROUNDINGS, self.surroundings.tolist(), strict=True))
        return np.array([sigma.get(name, self.zeros) for name in self.own_names(session)])

    def by_session(self, session: int) -> Floats:
        """(8 + 6 n + 5, k): how z changes with them."""
        names = self.own_names(session)
        T, every = np.zeros((self._size + len(SURROUNDINGS), len(names))), list(self.names)
        for k, name in enumerate(names):
            if name in SURROUNDINGS:
                T[self._size + SURROUNDINGS.index(name), k] = 1.0
            else:
                T[:, k] = self.by_arm[:, every.index(name)]
        return T

    @cached_property
    def _places(self) -> list[tuple[slice, dict[str, slice]]]:
        """Where the unknowns of each session, and of its data by kind, stand among all."""
        at, found = len(self.names), []
        for k, session in enumerate(self.sessions):
            own = slice(at, at := at + len(self.own_names(k)))
            data = {}
            for kind, evidence in session.items():
                data[kind] = slice(at, at := at + len(evidence.begin()))
            found.append((own, data))
        return found

    def own(self, session: int) -> slice:
        """Where a session's own parameters stand among all unknowns."""
        return self._places[session][0]

    def start(self, moved: Sequence[Floats] = (), arm: Floats | None = None) -> Floats:
        """All unknowns to begin with, and what the data's own then must have been.

        Args:
            moved: each session's own parameters; 0 by default.
            arm: (p,) parameters of the arm; the guess by default.
        """
        parts = [self.guess if arm is None else arm]
        for k, session in enumerate(self.sessions):
            parts.append(moved[k] if moved else np.zeros(len(self.own_names(k))))
            parts += [evidence.begin() for evidence in session.values()]
        x = np.concatenate(parts)
        for _ in range(FIRST):
            for k in range(len(self.sessions)):
                for _, linear, own in self.parts(x, k):
                    x[own] = x[own] + _step(linear, np.zeros(len(self.by_arm)))
        return x

    def z(self, x: Floats, session: int) -> Floats:
        """What the data of a session depend on besides their own unknowns."""
        z = self.by_arm @ (x[: len(self.names)] - self.guess)
        z[: self._size] += self.arm.vector()
        return np.asarray(z + self.by_session(session) @ x[self.own(session)])

    def parts(self, x: Floats, session: int) -> list[Part]:
        """What a session's data say near some values of all unknowns, by kind."""
        z, (_, places) = self.z(x, session), self._places[session]
        every = self.sessions[session].items()
        return [Part(kind, one.near(z, x[places[kind]]), places[kind]) for kind, one in every]

    def rows(self, x: Floats, session: int, parts: Sequence[Part]) -> tuple[Floats, Floats, Floats]:
        """A session's observations: regressors by the arm's parameters and its own, residuals."""
        own, sigma = x[self.own(session)], self.own_deviations(session)
        R = np.concatenate(
            [*(part.linear.regressor for part in parts), np.zeros((0, len(self.by_arm)))]
        )
        r = np.concatenate([*(part.linear.residuals for part in parts), -own / sigma])
        A = np.concatenate([R @ self.by_arm, np.zeros((len(sigma), len(self.names)))])
        return A, np.concatenate([R @ self.by_session(session), np.diag(1.0 / sigma)]), r

    @cached_property
    def prior_rows(self) -> Floats:
        """(k, p) the priors as rows of a regressor: the inverse root of their covariance."""
        rows = np.zeros((len(self.believed), len(self.names)))
        C = self.prior[np.ix_(self.believed, self.believed)]
        rows[:, self.believed] = np.linalg.inv(np.linalg.cholesky(C)) if len(C) else C
        return rows

    def linearize(self, x: Floats, without: str = "") -> Linear:
        """The problem of the p parameters of the arm near some values of all unknowns.

        Args:
            x: all unknowns.
            without: a kind of data to leave out.
        """
        p, cost, few, found = len(self.names), np.zeros(()), [], []
        for k in range(len(self.sessions)):
            parts = [part for part in self.parts(x, k) if part.kind != without]
            A, B, r = self.rows(x, k, parts)
            reduced = eliminate(A[None], B[None], r[None])
            few.append(_compressed(np.column_stack([reduced.regressor, reduced.residuals])))
            found.append((k, parts, reduced))
            cost = (
                cost + np.sum(r[len(r) - len(B.T) :] ** 2) + sum(one.linear.cost for one in parts)
            )
        off = self.prior_rows @ (self.guess - x[:p])
        rows = np.concatenate([*few, np.column_stack([self.prior_rows, off])])

        def extend(dx: Floats) -> Floats:
            steps = [dx]
            for k, parts, reduced in found:
                dy = _step(reduced, dx)
                dz = self.by_arm @ dx + self.by_session(k) @ dy
                steps += [dy, *(_step(linear, dz) for _, linear, _ in parts)]
            return np.concatenate(steps)

        return Linear(rows[:, p], rows[:, :p], cost + off @ off, extend)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Of the data that there are."""
        return tuple(dict.fromkeys(kind for session in self.sessions for kind in session))

    @property
    def degrees_of_freedom(self) -> int:
        """Observations and priors less the unknowns; a session's own have a prior each."""
        free = sum(one.free for session in self.sessions for one in session.values())
        return free + len(self.believed) - len(self.names)


def _step(linear: Linear, dz: Floats) -> Floats:
    """The step of data's own unknowns."""
    assert linear.extend is not None
    return linear.extend(dz)[len(dz) :]


def _compressed(rows: Floats) -> Floats:
    """As few rows as hold the same, as to products of columns."""
    return np.linalg.qr(rows)[1] if len(rows) > len(rows.T) else rows


@dataclass(frozen=True)
class JointResult:
    """p parameters of the arm from all data, those of each session, and how far to believe them."""

    problem: JointProblem
    minimum: Minimum

    @property
    def values(self) -> Floats:
        """(p,) in the order and units of problem.names and problem.units."""
        return self.minimum.x[: len(self.problem.names)]

    @cached_property
    def covariance(self) -> Floats:
        """(p, p) of the values."""
        return self.minimum.basis.covariance()

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Names of parameters that the data cannot tell apart, those at a bound left out."""
        lost = (self.minimum.basis.undetermined() > NOTICEABLE) & ~self.minimum.held
        return tuple(compress(self.problem.names, lost))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that the data would move out of their bounds."""
        return tuple(compress(self.problem.names, self.minimum.held))

    def session(self, k: int) -> tuple[Floats, Floats]:
        """Values and deviations of a session's own parameters."""
        problem, x = self.problem, self.minimum.x
        A, B, _ = problem.rows(x, k, problem.parts(x, k))
        by_arm = np.linalg.lstsq(B, A)[0]
        C = np.linalg.inv(B.T @ B) + by_arm @ self.covariance @ by_arm.T
        return x[problem.own(k)], np.sqrt(np.diag(C))

    @cached_property
    def fits(self) -> dict[str, tuple[float, int]]:
        """Of each kind of data, the sum of squares of its residuals, and observations less own."""
        found = dict.fromkeys(self.problem.kinds, (0.0, 0))
        for k, session in enumerate(self.problem.sessions):
            for kind, linear, _ in self.problem.parts(self.minimum.x, k):
                cost, free = found[kind]
                found[kind] = cost + float(linear.cost), free + session[kind].free
        return found

    @cached_property
    def without(self) -> dict[str, Floats]:
        """(p,) deviations that would be left without the data of a kind; inf: not determined."""
        found = {}
        for kind in self.problem.kinds:
            Phi = self.problem.linearize(self.minimum.x, kind).regressor
            basis = Decomposition.of(Phi)
            lost = basis.undetermined() > NOTICEABLE
            found[kind] = np.where(lost, inf, np.sqrt(np.diag(basis.covariance())))
        return found

    def calibrated(self) -> Arm:
        """The initial arm with all values, and what is known of them.

        Raises:
            DescriptionError: a value cannot be right.
        """
        problem, size = self.problem, 5 * self.problem.arm.n + 6
        arm = with_values(problem.arm, self.values[:size])
        theta_E = float(self.values[-1]) if problem.theta_e else arm.theta_E
        return replace(arm, theta_E=theta_E, known=arm.known.told(problem.names, self.covariance))


def solve(
    problem: JointProblem,
    start: Floats | None = None,
    bounded: bool = True,
) -> JointResult:
    """The most probable values of all unknowns.

    Args:
        problem: the data and what is known.
        start: all unknowns; problem.start() by default.
        bounded: keep to problem.bounds; deviations are true where none is active.
    """
    begin = problem.start() if start is None else start
    bounds = problem.bounds if bounded else None
    return JointResult(problem, minimize(problem.linearize, begin, bounds, TOLERANCE))
