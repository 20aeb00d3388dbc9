"""Estimation of the standard deviations of observations from the residuals of a solution.

S is the sum of the squared residuals of one kind of coordinate (e.g. positions) in assumed
deviations, and nu its degrees of freedom: the trace of 1 - hat, since the parameters absorb the
rest. If the true deviation is f times the assumed one, S / f^2 is chi-square with nu degrees of
freedom, and

    f^2 = S / (nu - 2)

follows from the mean of the inverse of chi-square, 1 / (nu - 2). With it, the covariance of the
parameters is on average as large as their squared errors, although f itself is known only to about
1 / sqrt(2 nu).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats, Mask
from fss_arm_calib.estimation.statistics import probability

FEWEST = 4.0  # degrees of freedom needed to estimate the deviation of a kind of coordinate
LEAST = 1e-3  # smallest estimate, as a fraction of the largest deviation; for exact data
ROUNDS, SETTLED = 20, 1e-4  # most iterations, and the relative change that stops them


R = TypeVar("R")
S = TypeVar("S", bound=Any)


class Limits(Protocol):
    """Settings for the deviations of positions and headings."""

    @property
    def position_deviation(self) -> float:
        """Standard deviation of a position [m]; 0: estimate it."""

    @property
    def heading_deviation(self) -> float:
        """Standard deviation of a heading [rad]; 0: estimate it."""

    @property
    def max_position_deviation(self) -> float:
        """Largest accepted estimate of the position deviation [m]."""

    @property
    def max_heading_deviation(self) -> float:
        """Largest accepted estimate of the heading deviation [rad]."""

    @property
    def min_probability(self) -> float:
        """Probability of residuals below which they are not explained by noise alone."""


class Left(NamedTuple):
    """Residuals of positions and headings after a solution, (2,) each."""

    squares: Floats  # sums of squared residuals, in the assumed deviations
    freedom: Floats  # degrees of freedom left


@dataclass(frozen=True)
class Noise:
    """Standard deviations of positions [m] and headings [rad], (2,) each."""

    deviations: Floats
    uncertainty: Floats  # standard deviations of `deviations`; 0: given
    largest: Floats  # largest accepted deviations
    freedom: float  # degrees of freedom of the estimate; inf: given

    @property
    def given(self) -> Mask:
        """Mask (2,), True for deviations that are given, not estimated."""
        return np.asarray(self.uncertainty == 0.0)

    def given_to(self, settings: S) -> S:
        """Return the settings with these deviations as given values."""
        position, heading = self.deviations.tolist()
        return replace(settings, position_deviation=position, heading_deviation=heading)

    def __str__(self) -> str:
        texts = []
        for k, (scale, unit) in enumerate(((1e3, "mm"), (np.degrees(1.0), "degrees"))):
            value, by = scale * self.deviations[k], scale * self.uncertainty[k]
            expected = f"up to {scale * self.largest[k]:.3g} expected"
            if value > scale * self.largest[k]:  # accepted only because the excess is by chance
                expected += ", more within chance"
            found = f"± {by:.1g} {unit} ({expected})" if by else unit
            texts.append(f"{value:.2g} {found}")
        return " and ".join(texts)


class Solved(NamedTuple, Generic[R]):
    """Solution with the deviations estimated from its residuals."""

    result: R
    noise: Noise
    first: R  # with the given deviations, and the largest accepted ones of those to estimate


def assumed(s: Limits) -> Noise:
    """Return the given deviations, and the largest accepted ones of those to estimate."""
    given = np.array([s.position_deviation, s.heading_deviation])
    largest = np.array([s.max_position_deviation, s.max_heading_deviation])
    deviations = np.where(given > 0.0, given, largest)
    return Noise(deviations, np.zeros(2), deviations, np.inf)


def estimated(
    s: Limits, solve: Callable[[Floats], tuple[R, Left | None]], used: Mask | None = None
) -> Solved[R]:
    """Solve repeatedly with the deviations estimated from the residuals, until these converge.

    If the residuals are larger than the largest accepted deviations explain, they are not caused by
    noise alone; the largest accepted deviations are then kept.

    Args:
        s: given deviations and limits of the estimated ones.
        solve: solves with deviations of positions and headings (2,); returns the result and its
            residuals, or None in their place if these are not known.
        used: (2,) True if positions, headings are observed.
    """
    noise = assumed(s)
    free = np.array([s.position_deviation == 0.0, s.heading_deviation == 0.0])
    free &= np.ones(2, bool) if used is None else used
    result, left = solve(noise.deviations)
    first = result
    if left and probability(left.squares.sum(), left.freedom.sum()) < s.min_probability:
        return Solved(first, noise, first)
    for _ in range(ROUNDS if free.any() else 0):
        if left is None or (found := _factors(left, free)) is None:
            break
        factors, freedom = found
        deviations = np.maximum(factors * noise.deviations, LEAST * noise.largest)
        change = np.max(np.abs(deviations / noise.deviations - 1.0))
        uncertainty = np.where(free, deviations / np.sqrt(2.0 * freedom), 0.0)
        seen = (deviations > LEAST * noise.largest).all()
        by = float(np.sum(left.freedom[free])) if seen else np.inf
        noise = Noise(deviations, uncertainty, noise.largest, by)
        if change < SETTLED:
            break
        result, left = solve(deviations)
    return Solved(result, noise, first)


def _factors(left: Left, free: Mask) -> tuple[Floats, Floats] | None:
    """Return the factors of the deviations (2,) and the degrees of freedom; None: too few."""
    squares, freedom = left
    if (freedom[free] < FEWEST).any():  # use one factor for both
        squares = np.full(2, np.sum(squares[free]))
        freedom = np.full(2, np.sum(freedom[free]))
    if (freedom[free] < FEWEST).any():
        return None
    factors = np.sqrt(squares / np.maximum(freedom - 2.0, 1.0))
    return np.where(free, factors, 1.0), freedom
