"""Weighted nonlinear least squares by Gauss-Newton steps that descend and stay within bounds.

Residuals and regressors are divided by the standard deviations of the observations, so that the
inverse of Phi' Phi is the covariance of the estimate.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from math import inf, sqrt
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats

Mask = npt.NDArray[np.bool_]


class Loss(NamedTuple):
    """Cost and weight of an observation, as functions of its squared length d2 in deviations."""

    cost: Callable[[Floats], Floats]  # rho(d2)
    weight: Callable[[Floats], Floats]  # rho'(d2)


HUBER_THRESHOLD = 2.8  # of the Huber loss [deviations]; 95% of all observations are shorter
CAUCHY_SCALE = 4.0  # of the Cauchy loss [deviations], for an efficiency of about 95%

SQUARE, HUBER, CAUCHY = "square", "huber", "cauchy"
LOSSES = {
    SQUARE: Loss(lambda d2: d2, np.ones_like),
    HUBER: Loss(
        lambda d2: np.where(
            d2 <= HUBER_THRESHOLD**2, d2, 2.0 * HUBER_THRESHOLD * np.sqrt(d2) - HUBER_THRESHOLD**2
        ),
        lambda d2: HUBER_THRESHOLD / np.sqrt(np.maximum(d2, HUBER_THRESHOLD**2)),
    ),
    CAUCHY: Loss(
        lambda d2: CAUCHY_SCALE**2 * np.log1p(d2 / CAUCHY_SCALE**2),
        lambda d2: 1.0 / (1.0 + d2 / CAUCHY_SCALE**2),
    ),
}


ROUNDING_ERROR = 1e-13  # steps below this are rounding errors [unit of the parameter]
COST_ROUNDING = 1e-12  # relative rounding error of a sum of squares of thousands of residuals
UNCHECKED_STEP = 1e-6  # smaller steps are not checked to lower the sum of squares [deviations]
MAX_CONDITION = 1e6  # of the column-scaled regressor; above, rounding errors dominate
MAX_UNDETERMINED_SHARE = 1e-6  # of a parameter in omitted directions; above, it is not known
MAX_ITERATIONS = 50


class Decomposition(NamedTuple):
    """Singular values of the column-scaled regressor, Phi / scale = U diag(s) Vt.

    Singular values that are too small relative to the largest are omitted: the observations contain
    no information in these directions.
    """

    scale: Floats  # (p,)
    U: Floats  # (m, rank)
    s: Floats  # (rank,)
    Vt: Floats  # (rank, p)
    condition: float

    @classmethod
    def of(cls, Phi: Floats, max_condition: float = MAX_CONDITION) -> "Decomposition":
        """Decompose a regressor (m, p); a column of zeros belongs to a parameter that is fixed."""
        norms = np.sqrt(np.einsum("ij,ij->j", Phi, Phi))
        scale = np.where(norms > 0.0, norms, 1.0)
        U, s, Vt = np.linalg.svd(Phi / scale, full_matrices=False)
        keep = s * max_condition > s[0]
        condition = s[0] / s[-1] if len(s) == len(scale) and s[-1] > 0.0 else inf
        return cls(scale, U[:, keep], s[keep], Vt[keep], float(condition))

    def step(self, residuals: Floats, damping: float = 0.0) -> Floats:
        """Return the least-squares step (p,); damping turns it to steepest descent (Levenberg)."""
        return self.Vt.T @ (self.s / (self.s**2 + damping) * (self.U.T @ residuals)) / self.scale

    def covariance(self) -> Floats:
        """Return the inverse of Phi' Phi, (p, p); 0 in the omitted directions."""
        root = self.Vt.T / self.s / self.scale[:, None]
        return root @ root.T

    def lost(self, max_share: float = MAX_UNDETERMINED_SHARE) -> Mask:
        """Return a mask (p,) of parameters with a larger share in the omitted directions."""
        return np.asarray(1.0 - np.sum(self.Vt**2, axis=0) > max_share)


class Linear(NamedTuple):
    """Problem linearized at x: residuals - regressor @ dx."""

    residuals: Floats  # (m,)
    regressor: Floats  # (m, p)
    cost: Floats  # () the sum of squares to minimize
    extend: Callable[[Floats], Floats] | None = None  # from dx (p,) to a step of all unknowns
    absorbed: Floats = np.empty(0)  # (rows,) share of each row that eliminated unknowns absorb


@dataclass(frozen=True)
class Minimum:
    """Minimum of the sum of squares."""

    x: Floats  # all unknowns
    linear: Linear  # at x
    basis: Decomposition  # at x, with parameters at a bound fixed
    at_bound: Mask  # (p,) True for parameters at a bound that they would cross
    iterations: int
    last_update: float  # largest component of the next step, in the parameter's deviations
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squares at the minimum."""
        return float(self.linear.cost)


@dataclass(frozen=True)
class Fit:
    """Result of a problem with p parameters: the minimum of its sum of squares."""

    problem: Any  # with `names` (p)
    minimum: Minimum
    max_share: ClassVar = MAX_UNDETERMINED_SHARE  # as in Decomposition.lost

    @cached_property
    def random(self) -> Floats:
        """Covariance (p, p) due to the errors of observations and priors alone."""
        return self.minimum.basis.covariance()

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (p, p) of the values."""
        return self.random

    @property
    def free(self) -> Mask:
        """Mask of the unknowns that are estimated and not at a bound."""
        return ~self.minimum.at_bound

    @property
    def values(self) -> Floats:
        """Estimates (p,) in the order of problem.names."""
        return self.minimum.x[: len(self.problem.names)]

    @cached_property
    def deviations(self) -> Floats:
        """Standard deviation (p,) of each parameter; inf if it is not determined."""
        lost = self.minimum.basis.lost(self.max_share)
        return np.where(lost, inf, np.sqrt(np.diag(self.covariance)))

    @property
    def condition_number(self) -> float:
        """Condition number of the column-scaled regressor and priors, of the free unknowns."""
        Phi = self.minimum.linear.regressor[:, self.free]
        return Decomposition.of(Phi).condition if Phi.size else 1.0

    @property
    def missing(self) -> int:
        """Number of combinations of free unknowns that are not determined."""
        return int(np.count_nonzero(self.free)) - len(self.minimum.basis.s)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that the data would move out of their bounds."""
        return tuple(compress(self.problem.names, self.minimum.at_bound))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of parameters that the data do not separate, except those at a bound."""
        lost = self.minimum.basis.lost(self.max_share) & self.free
        return tuple(compress(self.problem.names, lost))


def minimize(
    linearize: Callable[[Floats], Linear],
    start: Floats,
    bounds: tuple[Floats, Floats] | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = MAX_ITERATIONS,
    max_condition: float = MAX_CONDITION,
) -> Minimum:
    """Minimize by Gauss-Newton; damp a step until it lowers the sum of squares.

    Args:
        linearize: returns the problem linearized at x.
        start: all unknowns, the p parameters first; the others are eliminated, see `extend`.
        bounds: smallest and largest value of each parameter, (p,) each.
        tolerance: update below which the solution has converged, in the parameter's deviations.
        max_iterations: limit of the iterations; if it is reached, `converged` is False.
        max_condition: condition number of the column-scaled regressor above which parameters are
            inseparable.
    """
    x, linear = start, linearize(start)
    p = linear.regressor.shape[1]
    low, high = bounds if bounds else (np.full(p, -inf), np.full(p, inf))
    damping = 0.0
    for iteration in range(max_iterations + 1):
        basis, at_bound, step = _step(linear, x[:p], low, high, damping, max_condition)
        update = _largest_update(step, basis)
        negligible = update < tolerance or float(np.max(np.abs(step), initial=0.0)) < ROUNDING_ERROR
        converged = damping == 0.0 and negligible
        if converged or iteration == max_iterations:
            break
        x_next = x + (linear.extend(step) if linear.extend else step)
        x_next[:p] = np.minimum(np.maximum(x_next[:p], low), high)
        linear_next = linearize(x_next)
        # The change by such a short step is quadratic in its length and below rounding errors.
        unchecked = max(UNCHECKED_STEP, sqrt(COST_ROUNDING * float(linear.cost)))
        if update < unchecked or linear_next.cost <= linear.cost:
            x, linear = x_next, linear_next
            damping = damping / 10.0 if damping > 1e-3 else 0.0
        else:
            damping = max(10.0 * damping, 1e-3)
    if not converged and negligible:
        # The damped steps became negligible: check whether the undamped one is, too.
        basis, at_bound, step = _step(linear, x[:p], low, high, 0.0, max_condition)
        update = _largest_update(step, basis)
        converged = update < tolerance
    return Minimum(x, linear, basis, at_bound, iteration, update, converged)


def _largest_update(step: Floats, basis: Decomposition) -> float:
    """Return the largest component of a step, in the parameter's deviations."""
    deviations = np.sqrt(np.diag(basis.covariance()))
    sizes = np.abs(step[deviations > 0.0]) / deviations[deviations > 0.0]
    return float(np.max(sizes, initial=0.0))


def _step(
    linear: Linear, x: Floats, low: Floats, high: Floats, damping: float, max_condition: float
) -> tuple[Decomposition, Mask, Floats]:
    """Return the decomposition, a mask of the parameters fixed at a bound, and the step.

    Parameters whose best step ends at a bound are moved to it.
    """
    Phi, r = linear.regressor, linear.residuals
    basis = Decomposition.of(Phi, max_condition)
    step = basis.step(r, damping)
    if not ((x + step < low) | (x + step > high)).any():
        return basis, np.zeros(len(x), dtype=bool), step
    smallest = (basis.s[0] / max_condition) ** 2
    bounded = _bounded_step(Phi, r, basis.scale, low - x, high - x, max(damping, smallest))
    at_bound = (bounded <= low - x) | (bounded >= high - x)
    fixed = np.where(at_bound, bounded, 0.0)
    basis = Decomposition.of(np.where(at_bound, 0.0, Phi), max_condition)
    step = fixed + basis.step(r - Phi @ fixed, damping)
    return basis, at_bound, np.clip(step, low - x, high - x)


def _bounded_step(
    Phi: Floats, r: Floats, scale: Floats, low: Floats, high: Floats, damping: float
) -> Floats:
    """Return the damped least-squares step (p,) between bounds; an active one is met exactly."""
    from scipy.optimize import lsq_linear

    rows = compress_rows(np.column_stack([Phi / scale, r]))
    p = len(scale)
    A = np.concatenate([rows[:, :p], np.sqrt(damping) * np.eye(p)])
    b = np.concatenate([rows[:, p], np.zeros(p)])
    found = lsq_linear(A, b, (low * scale, high * scale), method="bvls", max_iter=20 * p)
    return np.select([found.active_mask < 0, found.active_mask > 0], [low, high], found.x / scale)


def eliminate(A: Floats, B: Floats, r: Floats) -> Linear:
    """Eliminate the own unknowns of each block of rows; the p shared parameters remain.

    With B = Q R of a block, its rows are projected: r - Q Q' r and A - Q Q' A. For a step dx of the
    shared parameters, the step of the block's own unknowns is R^-1 Q' (r - A dx).

    A (blocks, rows, p) are the regressors of the shared parameters, B (blocks, rows, k) those of
    each block's own unknowns, of full rank, k possibly 0; r (blocks, rows) are the residuals.
    """
    Q, R = np.linalg.qr(B)
    rows = np.concatenate([A, r[..., None]], axis=-1)
    components = np.swapaxes(Q, -1, -2) @ rows
    projected = rows - Q @ components
    solution = np.linalg.solve(R, components)

    def extend(dx: Floats) -> Floats:
        return np.concatenate([dx, (solution[..., -1] - solution[..., :-1] @ dx).ravel()])

    return Linear(
        residuals=projected[..., -1].ravel(),
        regressor=projected[..., :-1].reshape(r.size, A.shape[-1]),
        cost=np.asarray(np.sum(r**2)),
        extend=extend,
        absorbed=np.sum(Q**2, axis=-1).ravel(),
    )


def prior_regressor(covariance: Floats, indices: npt.NDArray[np.intp], size: int) -> Floats:
    """Return rows (k, size) of a regressor for priors of k of its parameters, at `indices`.

    They are the inverse root of the priors' covariance (k, k).
    """
    rows = np.zeros((len(covariance), size))
    rows[:, indices] = np.linalg.inv(np.linalg.cholesky(covariance))
    return rows


def compress_rows(rows: Floats) -> Floats:
    """Reduce the number of rows by a QR decomposition; products of columns are unchanged."""
    return np.linalg.qr(rows)[1] if len(rows) > len(rows.T) else rows


def solve_with_instruments(A: Floats, y: Floats, Z: Floats) -> Floats:
    """Solve Z' (y - A x) = 0 for x (p,), with 0 for empty columns; Z = A gives least squares.

    The instruments Z (m, p) are not correlated with the errors of the regressors A (m, p).
    """
    a, z = (np.where(norm, norm, 1.0) for norm in np.linalg.norm([A, Z], axis=1))
    return np.asarray(np.linalg.pinv((Z / z).T @ (A / a), rcond=1e-10) @ ((Z / z).T @ y) / a)
