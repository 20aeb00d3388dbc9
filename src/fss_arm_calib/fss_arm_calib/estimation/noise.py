"""How large the errors of observations are, by what residuals a solution leaves.

Of one kind of coordinate, as positions, the squares of residuals in assumed deviations add up to
S. Of their number, nu are left by what the parameters take (the trace of 1 - hat). If the true
deviation is f times the assumed one, S / f^2 is chi-square with nu degrees of freedom, and

    f^2 = S / (nu - 2)

is the mean of 1 / chi-square's inverse: with it the covariance of the parameters is as large on
average as their squared errors are, though f is known to about 1 / sqrt(2 nu) only.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats, Mask
from fss_arm_calib.estimation.statistics import probability

FEWEST = 4.0  # degrees of freedom by which a kind's own deviation is estimated
LEAST = 1e-3  # of the largest deviation: nothing is seen better, and exact data have some
ROUNDS, SETTLED = 20, 1e-4  # of estimating anew, and the change of f that ends it


R = TypeVar("R")
S = TypeVar("S", bound=Any)


class Limits(Protocol):
    """What is said of positions and headings, by settings."""

    @property
    def position_deviation(self) -> float:
        """1 sigma [m]; 0: to be estimated."""

    @property
    def heading_deviation(self) -> float:
        """1 sigma [rad]; 0: to be estimated."""

    @property
    def max_position_deviation(self) -> float:
        """Largest estimate to believe [m]."""

    @property
    def max_heading_deviation(self) -> float:
        """Largest estimate to believe [rad]."""

    @property
    def min_probability(self) -> float:
        """Of residuals: less likely ones are not of noise of such deviations."""


class Left(NamedTuple):
    """What a solution leaves of positions and headings, (2,) each."""

    squares: Floats  # of residuals, in the deviations that were assumed
    freedom: Floats  # degrees of freedom left


@dataclass(frozen=True)
class Noise:
    """Deviations of positions [m] and headings [rad], (2,) each."""

    deviations: Floats
    uncertainty: Floats  # 1 sigma of these; 0: given
    largest: Floats  # that are believed
    freedom: float  # by which all are known; inf: given

    @property
    def given(self) -> Mask:
        """(2,) which are not estimated."""
        return np.asarray(self.uncertainty == 0.0)

    def given_to(self, settings: S) -> S:
        """Settings by which these deviations are given."""
        position, heading = self.deviations.tolist()
        return replace(settings, position_deviation=position, heading_deviation=heading)

    def __str__(self) -> str:
        texts = []
        for k, (scale, unit) in enumerate(((1e3, "mm"), (np.degrees(1.0), "degrees"))):
            value, by = scale * self.deviations[k], scale * self.uncertainty[k]
            expected = f"up to {scale * self.largest[k]:.3g} expected"
            if value > scale * self.largest[k]:  # else they would not be believed
                expected += ", more within chance"
            found = f"± {by:.1g} {unit} ({expected})" if by else unit
            texts.append(f"{value:.2g} {found}")
        return " and ".join(texts)


class Solved(NamedTuple, Generic[R]):
    """What was solved with the deviations that its residuals have."""

    result: R
    noise: Noise
    first: R  # with what is given, and the largest of what is estimated


def assumed(s: Limits) -> Noise:
    """What is given, and the largest of what is to be estimated."""
    given = np.array([s.position_deviation, s.heading_deviation])
    largest = np.array([s.max_position_deviation, s.max_heading_deviation])
    deviations = np.where(given > 0.0, given, largest)
    return Noise(deviations, np.zeros(2), deviations, np.inf)


def estimated(
    s: Limits, solve: Callable[[Floats], tuple[R, Left | None]], used: Mask | None = None
) -> Solved[R]:
    """Solve, and again with the deviations that its residuals have, until these stay.

    If the residuals are larger than the largest deviations explain, they are not of noise alone:
    then these are kept.

    Args:
        s: what is given, and what is believed.
        solve: with deviations of positions and headings (2,); what is left, None: nothing is known.
        used: (2,) whether they are observed at all.
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
    """(2,) by what to multiply deviations, and the degrees of freedom; None: too few."""
    squares, freedom = left
    if (freedom[free] < FEWEST).any():  # one factor for all
        squares = np.full(2, np.sum(squares[free]))
        freedom = np.full(2, np.sum(freedom[free]))
    if (freedom[free] < FEWEST).any():
        return None
    factors = np.sqrt(squares / np.maximum(freedom - 2.0, 1.0))
    return np.where(free, factors, 1.0), freedom
