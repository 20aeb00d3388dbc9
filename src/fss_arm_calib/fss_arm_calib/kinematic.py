"""Kinematic calibration: the arm's lengths and angles from end-effector poses (Eq. 1-5).

An observation is a joint reading q (n,) and the end effector's pose seen from the base, (3,) x, y
[m], heading [rad]. With the difference of observed and predicted poses, headings wrapped,

    Delta x_EE = x_observed - k(q, xi)                                        (Eq. 2)
    Delta x_EE = Phi_k Delta xi                                               (Eq. 3)
    Delta xi = (Phi_k' W Phi_k)^-1 Phi_k' W Delta x_EE                        (Eq. 4)

is iterated until Delta xi is negligible. W holds the observations' known deviations (the paper
weighs metres and radians alike), so that the estimate has a covariance, (Phi_k' W Phi_k)^-1.
"""

from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm, kinematic_index, kinematic_names
from fss_arm_model.kinematics import tip_in_base, tip_regressor

Floats = npt.NDArray[np.float64]

FULL, EQUAL = "full", "equal"

#: The per-observation errors that give residuals such as the paper's 0.015 m and 0.683 degrees.
POSITION_DEVIATION = 0.0177  # [m], each axis
HEADING_DEVIATION = float(np.radians(0.715))

#: A parameter's share in the undetermined directions from which on it is named.
NOTICEABLE = 1e-3

#: A step below this changes a parameter by no more than rounding does [m, rad].
ROUNDING = 1e-13

#: A step below this is taken without asking whether it lowers the sum of squares [deviations].
SHORT = 1e-6


def wrap(angle: npt.ArrayLike) -> Floats:
    """The same angle [rad] in [-pi, pi)."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi


class NotIdentifiable(ValueError):  # noqa: N818
    """The observations cannot tell some parameters apart; the message names them."""

    def __init__(self, parameters: tuple[str, ...], undetermined: int, condition: float) -> None:
        self.parameters, self.undetermined, self.condition = parameters, undetermined, condition
        super().__init__(
            f"{', '.join(parameters)} cannot be told apart ({undetermined} "
            f"combination{'s' * (undetermined > 1)} undetermined, condition number {condition:.3g})"
        )


@dataclass(frozen=True)
class KinematicProblem:
    """s observations of an arm of n links, and what is known beforehand.

    Raises:
        ValueError: an array has the wrong shape or is not finite, or a setting is impossible.
    """

    q: Floats  # (s, n) joint readings [rad]
    tip: Floats  # (s, 3) end effector in the base's frame [m, m, rad]
    arm: Arm  # the initial guess
    parametrization: str = EQUAL  # one length for all links but the last, or FULL
    position_deviation: float = POSITION_DEVIATION  # of an observation, each axis, 1 sigma [m]
    heading_deviation: float = HEADING_DEVIATION  # likewise [rad]

    def __post_init__(self) -> None:
        q, tip = np.array(self.q, dtype=float), np.array(self.tip, dtype=float)
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "tip", tip)
        if q.ndim != 2 or q.shape[1] != self.arm.n:
            raise ValueError(f"q has shape {q.shape}, expected (s, {self.arm.n})")
        if tip.shape != (len(q), 3):
            raise ValueError(f"tip has shape {tip.shape}, expected ({len(q)}, 3)")
        if not (np.isfinite(q).all() and np.isfinite(tip).all()):
            raise ValueError("an observation is not finite")
        if self.parametrization not in (FULL, EQUAL):
            raise ValueError(
                f"parametrization is {self.parametrization!r}, expected {FULL!r} or {EQUAL!r}"
            )
        for name in ("position_deviation", "heading_deviation"):
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")

    @property
    def shares_length(self) -> bool:
        """Whether several links have one length among them."""
        return self.parametrization == EQUAL and self.arm.n > 2

    @property
    def names(self) -> tuple[str, ...]:
        """The p parameters, kinematic_names(n); if equal, `a` stands for a_1 .. a_{n-1}."""
        every = kinematic_names(self.arm.n)
        return ("a", *every[self.arm.n - 1 :]) if self.shares_length else every

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple("rad" if name.startswith("theta") else "m" for name in self.names)

    @cached_property
    def basis(self) -> Floats:
        """(2n+2, p): all kinematic parameters are basis @ xi."""
        size, shared = 2 * self.arm.n + 2, self.arm.n - 2 if self.shares_length else 0
        basis = np.eye(size)[:, shared:]
        basis[: shared + 1, 0] = 1.0
        return basis

    @property
    def initial(self) -> Floats:
        """(p,) the parameters of `arm`, unlike lengths averaged where they count as equal."""
        values = self.arm.vector()[kinematic_index(self.arm.n)]
        return np.asarray(np.linalg.lstsq(self.basis, values)[0])

    def all_parameters(self, xi: Floats) -> Floats:
        """(2n+2,) in the order of kinematic_names(n)."""
        return self.basis @ xi

    @property
    def sigma(self) -> Floats:
        """(3,) deviation of an observation."""
        return np.array([self.position_deviation] * 2 + [self.heading_deviation])

    def vector(self, xi: Floats) -> Floats:
        """The model's parameters with xi in place of the guess, (8 + 6n,)."""
        vector = self.arm.vector()
        vector[kinematic_index(self.arm.n)] = self.all_parameters(xi)
        return vector

    def residuals(self, xi: Floats) -> Floats:
        """Observed minus predicted poses (Eq. 2), (s, 3) [m, m, rad], the headings wrapped."""
        residuals = self.tip - tip_in_base(self.vector(xi), self.q)
        residuals[:, 2] = wrap(residuals[:, 2])
        return residuals

    def regressor(self, xi: Floats) -> Floats:
        """Phi_k (Eq. 5), rows weighted by 1/sigma: (3s, p)."""
        Phi = tip_regressor(self.vector(xi), self.q) @ self.basis
        return (Phi / self.sigma[:, None]).reshape(-1, self.basis.shape[1])


@dataclass(frozen=True)
class KinematicResult:
    """p parameters from s observations, and how far to believe them."""

    problem: KinematicProblem
    values: Floats  # (p,) in the order and units of problem.names and problem.units
    covariance: Floats  # (p, p)
    residuals: Floats  # (s, 3) observed minus predicted [m, m, rad]
    chi_square: float  # weighted sum of squared residuals
    condition_number: float  # of the column-scaled regressor
    iterations: int
    last_update: float  # largest change in the last iteration, in the parameter's deviations
    converged: bool

    @property
    def deviations(self) -> Floats:
        """(p,) 1 sigma of each parameter."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def degrees_of_freedom(self) -> int:
        """3s - p."""
        return self.residuals.size - self.values.size

    @property
    def position_residual(self) -> float:
        """Standard deviation of the 2s position residuals: root mean square about zero [m]."""
        return float(np.sqrt(np.mean(self.residuals[:, :2] ** 2)))

    @property
    def heading_residual(self) -> float:
        """Standard deviation of the s heading residuals: root mean square about zero [rad]."""
        return float(np.sqrt(np.mean(self.residuals[:, 2] ** 2)))

    def calibrated(self) -> Arm:
        """The initial arm with the estimated parameters.

        Raises:
            DescriptionError: a length is not positive.
        """
        return self.problem.arm.with_kinematics(self.problem.all_parameters(self.values))


class _Decomposition(NamedTuple):
    """Singular values of the column-scaled regressor, Phi / scale = U diag(s) Vt.

    Those too small against the largest are left out: along them the observations say nothing.
    """

    scale: Floats  # (p,)
    U: Floats  # (3s, rank)
    s: Floats  # (rank,)
    Vt: Floats  # (rank, p)
    condition: float

    @classmethod
    def of(cls, Phi: Floats, max_condition: float) -> "_Decomposition":
        norms = np.linalg.norm(Phi, axis=0)
        scale = np.where(norms > 0.0, norms, 1.0)
        U, s, Vt = np.linalg.svd(Phi / scale, full_matrices=False)
        keep = s * max_condition > s[0]
        condition = s[0] / s[-1] if len(s) == len(scale) and s[-1] > 0.0 else inf
        return cls(scale, U[:, keep], s[keep], Vt[keep], float(condition))

    def step(self, residuals: Floats, damping: float) -> Floats:
        """Eq. 4; a positive damping turns and shortens it towards steepest descent (Levenberg)."""
        return self.Vt.T @ (self.s / (self.s**2 + damping) * (self.U.T @ residuals)) / self.scale

    def covariance(self) -> Floats:
        root = self.Vt.T / self.s / self.scale[:, None]
        return root @ root.T

    def undetermined(self) -> Floats:
        """(p,) share of each parameter in the directions left out, 0 to 1."""
        return 1.0 - np.sum(self.Vt**2, axis=0)


def solve(
    problem: KinematicProblem,
    tolerance: float = 1e-9,
    max_iterations: int = 50,
    max_condition: float = 1e3,
) -> KinematicResult:
    """Iterate Eq. 4 (Gauss-Newton) from the better of the guess and the closed form.

    A step that would not lower the weighted sum of squares is damped until it does.

    Args:
        problem: observations and initial guess.
        tolerance: the update below which it has converged, in the parameter's deviations.
        max_iterations: it gives up after so many, `converged` then is False.
        max_condition: of the column-scaled regressor, beyond it parameters count as inseparable.

    Raises:
        NotIdentifiable: the observations are too few or too alike for all parameters.
    """
    starts = [problem.initial, *_closed_form(problem)]
    xi = min(starts, key=lambda start: _weighted_squares(problem, start))
    cost, damping, converged = _weighted_squares(problem, xi), 0.0, False
    basis = _Decomposition.of(problem.regressor(xi), max_condition)
    for iteration in range(1, max_iterations + 1):  # noqa: B007
        residuals = (problem.residuals(xi) / problem.sigma).ravel()
        step = basis.step(residuals, damping)
        update = float(np.max(np.abs(step) / np.sqrt(np.diag(basis.covariance()))))
        negligible = update < tolerance or float(np.max(np.abs(step))) < ROUNDING
        converged = damping == 0.0 and negligible
        next_cost = _weighted_squares(problem, xi + step)
        # A step so short changes the sum of squares by its square: less than rounding does.
        if update < SHORT or next_cost <= cost:
            xi, cost = xi + step, next_cost
            damping = damping / 10.0 if damping > 1e-3 else 0.0
            basis = _Decomposition.of(problem.regressor(xi), max_condition)
        else:
            damping = max(10.0 * damping, 1e-3)
        if converged:
            break
    missing = len(xi) - len(basis.s)
    if missing:
        shares = zip(problem.names, basis.undetermined(), strict=True)
        names = tuple(name for name, share in shares if share > NOTICEABLE)
        raise NotIdentifiable(names, missing, basis.condition)
    angles = np.array(problem.units) == "rad"
    return KinematicResult(
        problem=problem,
        values=np.where(angles, wrap(xi), xi),
        covariance=basis.covariance(),
        residuals=problem.residuals(xi),
        chi_square=cost,
        condition_number=basis.condition,
        iterations=iteration,
        last_update=update,
        converged=converged,
    )


def _weighted_squares(problem: KinematicProblem, xi: Floats) -> float:
    return float(np.sum((problem.residuals(xi) / problem.sigma) ** 2))


def _closed_form(problem: KinematicProblem) -> list[Floats]:
    """A start that needs no guess, from the positions alone; none if they do not suffice.

    With complex numbers for the plane's vectors and Q_i = q_1 + .. + q_i, the end effector is at

        x + i y = m + sum_i z_i exp(i Q_i)
        z_i = a_i exp(i (theta_BJ1 + theta_0_2 + .. + theta_0_i))

    which is linear in the mount m and the z_i. Lengths found as |z_i| are never negative, so this
    start also keeps the iteration from the mirrored arms that fit the positions as well.
    """
    n, turns = problem.arm.n, np.exp(1j * np.cumsum(problem.q, axis=1))
    columns = np.column_stack([np.ones(len(turns)), turns])
    positions = problem.tip[:, 0] + 1j * problem.tip[:, 1]
    z, _, rank, _ = np.linalg.lstsq(columns, positions)
    if rank < n + 1 or not np.all(z[1:]):
        return []
    headings = np.angle(z[1:])
    offsets = wrap(np.diff(headings))
    values = np.concatenate([np.abs(z[1:]), offsets, [z[0].real, z[0].imag, headings[0]]])
    return [np.linalg.lstsq(problem.basis, values)[0]]


def quantization_bound(
    problem: KinematicProblem, half_count: float, values: npt.ArrayLike | None = None
) -> Floats:
    """How far readings off by up to `half_count` can move the parameters, to first order, (p,).

    If the readings are q + e while the poses are exact, the fit obeys Phi dxi + Phi_q e = 0 in the
    weighted least squares sense, Phi_q holding the poses' derivatives by each reading, so that

        dxi = -Phi^+ Phi_q e
        |dxi_j| <= half_count * sum_k |(Phi^+ Phi_q)_jk|        for all |e_k| <= half_count

    with equality for the worst signs of e. A reading enters as its joint's offset does, therefore
    Phi_q takes the columns of theta_BJ1, theta_0_2 .. theta_0_n, each observation's own.
    Second-order terms are of the size of half_count^2 [m, rad]: 1e-10 for 240,000 counts a turn.

    Args:
        problem: the observations; its deviations are the weights.
        half_count: largest error of a reading [rad]: half an encoder count, pi / counts_per_turn,
            plus what the joint may move within the rest beside its average.
        values: (p,) where to linearize, the problem's initial guess by default.

    Returns:
        (p,) bound of each parameter's error, in its unit.
    """
    n, s = problem.arm.n, len(problem.q)
    xi = problem.initial if values is None else np.asarray(values, dtype=float)
    by_offset = tip_regressor(problem.vector(xi), problem.q)[..., [2 * n + 1, *range(n, 2 * n - 1)]]
    Phi_q = np.zeros((s, 3, s, n))
    Phi_q[np.arange(s), :, np.arange(s), :] = by_offset / problem.sigma[:, None]
    influence = np.linalg.pinv(problem.regressor(xi)) @ Phi_q.reshape(3 * s, s * n)
    return half_count * np.sum(np.abs(influence), axis=1)
