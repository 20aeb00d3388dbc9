"""Solving without data that contradict the others, or with less weight for them."""

from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from fss_arm_calib.estimation.least_squares import LOSSES, SQUARE, Floats, Mask

ROUNDS = 20  # of weighing data anew by a robust loss


class Limits(Protocol):
    """What may be done about outliers."""

    @property
    def outlier(self) -> float:
        """The error above which a datum is one, in its deviations."""

    @property
    def max_outliers(self) -> int:
        """Most to reject."""


R = TypeVar("R")


class Kept(NamedTuple, Generic[R]):
    """A result, and which of s data it is from."""

    result: R  # of those kept
    mask: Mask  # (s,)
    reasons: tuple[str, ...]  # (s,) why it was rejected, else empty
    errors: Floats  # (s,) of each, or when it was rejected [deviations]


def without_outliers(
    solve: Callable[[Mask], tuple[R, Floats]],
    size: int,
    limits: Limits,
    fewest: int,
    what: str,
) -> Kept[R]:
    """Solve, and reject as many outliers as allowed, one after the other.

    Args:
        solve: from data chosen by a mask (size,), the result and the error of each of them.
        size: number of data.
        limits: what is an outlier, and how many may be rejected.
        fewest: data that must remain.
        what: the error is, in words.
    """
    mask, reasons, errors = np.ones(size, dtype=bool), [""] * size, np.zeros(size)
    while True:
        result, errors[mask] = solve(mask)
        worst = int(np.argmax(np.where(mask, errors, 0.0)))
        length, rejected = float(errors[worst]), int(np.sum(~mask))
        enough = size - rejected > fewest  # to do without one
        if length <= limits.outlier or rejected >= limits.max_outliers or not enough:
            return Kept(result, mask, tuple(reasons), errors)
        mask[worst] = False
        reasons[worst] = f"{what} {length:.3g}, more than {limits.outlier:g}"


def weighed(
    solve: Callable[[Floats], tuple[R, Floats]], size: int, loss: str
) -> tuple[R, Floats, Floats]:
    """Solve with each datum weighed by a loss of its error against the others.

    Args:
        solve: by weights (size,), the result and the error of each datum as weighed, each the root
            mean square of a coordinate.
        size: number of data.
        loss: one of LOSSES, of three coordinates.

    Returns:
        The result, the weights and the errors (size,) in deviations not weighed.
    """
    weights = np.ones(size)
    for _ in range(1 if loss == SQUARE else ROUNDS):
        result, errors = solve(weights)
        errors = errors / np.sqrt(weights)
        if loss != SQUARE:
            weights = LOSSES[loss].weight(3.0 * errors**2)
    return result, weights, errors
