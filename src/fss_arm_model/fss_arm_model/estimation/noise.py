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
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.estimation.least_squares import Mask
from fss_arm_model.estimation.statistics import probability

MIN_FREEDOM = 4.0  # degrees of freedom needed to estimate the deviation of a kind of coordinate
MIN_DEVIATION_RATIO = 1e-3  # smallest estimate relative to the largest deviation; for exact data
MAX_ITERATIONS = 20
MAX_CHANGE = 1e-4  # relative change of the deviations below which they have converged


R = TypeVar("R")
N = TypeVar("N", bound="Noise")
S = TypeVar("S", bound=Any)


class ResidualSums(NamedTuple):
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
    def is_given(self) -> Mask:
        """Mask (2,), True for deviations that are given, not estimated."""
        return np.asarray(self.uncertainty == 0.0)

    def apply_to(self, settings: S) -> S:
        """Return the settings with these deviations in place of theirs."""
        position, heading = self.deviations.tolist()
        return replace(settings, position_deviation=position, heading_deviation=heading)

    def __str__(self) -> str:
        texts = []
        for k, (scale, unit) in enumerate(((1e3, "mm"), (np.degrees(1.0), "degrees"))):
            value, uncertainty = scale * self.deviations[k], scale * self.uncertainty[k]
            limit = f"{scale * self.largest[k]:.3g} {unit} assumed"
            if value > scale * self.largest[k]:
                limit += "; the excess is not significant"
            else:
                limit = f"at most {limit}"
            estimate = f"± {uncertainty:.1g} {unit} ({limit})" if uncertainty else unit
            texts.append(f"{value:.2g} {estimate}")
        return " and ".join(texts)


class NoiseSolution(NamedTuple, Generic[R, N]):
    """Solution with the deviations estimated from its residuals."""

    result: R
    noise: N
    nominal: R  # with the given deviations, and the largest accepted ones of those to estimate


def assumed_noise(s: Any) -> Noise:
    """Return the given deviations, and the largest accepted ones of those to estimate.

    `s` has position_deviation and heading_deviation, 0 if not given, and the largest accepted
    ones, max_position_deviation [m] and max_heading_deviation [rad].
    """
    given = np.array([s.position_deviation, s.heading_deviation])
    largest = np.array([s.max_position_deviation, s.max_heading_deviation])
    deviations = np.where(given > 0.0, given, largest)
    return Noise(deviations, np.zeros(2), deviations, np.inf)


def solve_with_noise(
    s: Any,
    solve: Callable[[Floats], tuple[R, ResidualSums | None]],
    used: Mask | None = None,
) -> NoiseSolution[R, Noise]:
    """Solve repeatedly with the deviations estimated from the residuals, until these converge.

    If the residuals are larger than the largest accepted deviations explain, they are not caused by
    noise alone; the largest accepted deviations are then kept.

    Args:
        s: given deviations and limits of the estimated ones, as for assumed_noise; and
            min_probability, of residuals that noise alone explains.
        solve: solves with deviations of positions and headings (2,); returns the result and its
            residuals, or None in their place if these are not known.
        used: (2,) True if positions, headings are observed.
    """
    noise = assumed_noise(s)
    free = np.array([s.position_deviation == 0.0, s.heading_deviation == 0.0])
    free &= np.ones(2, bool) if used is None else used
    nominal, sums = solve(noise.deviations)
    if sums and probability(sums.squares.sum(), sums.freedom.sum()) < s.min_probability:
        return NoiseSolution(nominal, noise, nominal)
    result = nominal
    for _ in range(MAX_ITERATIONS if free.any() else 0):
        if sums is None or (found := _noise_factors(sums, free)) is None:
            break
        factors, freedom = found
        deviations = np.maximum(factors * noise.deviations, MIN_DEVIATION_RATIO * noise.largest)
        change = np.max(np.abs(deviations / noise.deviations - 1.0))
        uncertainty = np.where(free, deviations / np.sqrt(2.0 * freedom), 0.0)
        noisy = (deviations > MIN_DEVIATION_RATIO * noise.largest).all()
        total = float(np.sum(sums.freedom[free])) if noisy else np.inf
        noise = Noise(deviations, uncertainty, noise.largest, total)
        if change < MAX_CHANGE:
            break
        result, sums = solve(deviations)
    return NoiseSolution(result, noise, nominal)


def _noise_factors(sums: ResidualSums, free: Mask) -> tuple[Floats, Floats] | None:
    """Return the factors of the deviations (2,) and the degrees of freedom; None: too few."""
    squares, freedom = sums
    if (freedom[free] < MIN_FREEDOM).any():  # use one factor for both
        squares = np.full(2, np.sum(squares[free]))
        freedom = np.full(2, np.sum(freedom[free]))
    if (freedom[free] < MIN_FREEDOM).any():
        return None
    factors = np.sqrt(squares / np.maximum(freedom - 2.0, 1.0))
    return np.where(free, factors, 1.0), freedom
