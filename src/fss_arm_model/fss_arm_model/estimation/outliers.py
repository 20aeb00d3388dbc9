"""Solutions that reject data which contradict the others, or give them less weight."""

from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.estimation.least_squares import LOSSES, SQUARE, Mask

REWEIGHTINGS = 20  # number of iterations with a robust loss


R = TypeVar("R")


@dataclass(frozen=True)
class Solution(Generic[R]):
    """Result, and how each of the s data agrees with it."""

    result: R  # from the data that were not rejected
    kept: Mask  # (s,) data that were not rejected
    reasons: tuple[str, ...]  # (s,) why a datum was rejected; empty if it was not
    errors: Floats  # (s,) when predicted from the others, or at its rejection [deviations]
    weights: Floats  # (s,) 1: used; 0: rejected; between: weight of a robust loss
    leverage: Floats  # (s,)


class OutlierSolution(NamedTuple, Generic[R]):
    """Result, with a mask of the s data that it is computed from."""

    result: R  # from the data kept
    mask: Mask  # (s,) True for data kept
    reasons: tuple[str, ...]  # (s,) why a datum was rejected; empty if it was kept
    errors: Floats  # (s,) error of each datum; of a rejected one when it was rejected [deviations]


def expand(values: Floats, kept: Mask, missing: float = nan) -> Floats:
    """Return a row for each of s data from the rows of the data kept, with `missing` elsewhere."""
    every = np.full((len(kept), *values.shape[1:]), missing)
    every[kept] = values
    return every


def reject_outliers(
    solve: Callable[[Mask], tuple[R, Floats]],
    size: int,
    limit: float,
    max_outliers: int,
    min_count: int,
    error_name: str,
) -> OutlierSolution[R]:
    """Solve, and reject outliers one by one: at most `max_outliers`, so that `min_count` remain.

    `solve` takes a mask of `size` data and returns the result and the errors of these data, in
    their deviations. An outlier has an error above `limit`, with `error_name` in the reason.
    """
    mask, reasons, errors = np.ones(size, dtype=bool), [""] * size, np.zeros(size)
    while True:
        result, errors[mask] = solve(mask)
        worst = int(np.argmax(np.where(mask, errors, 0.0)))
        length, rejected = float(errors[worst]), int(np.sum(~mask))
        can_reject = rejected < max_outliers and size - rejected > min_count
        if length <= limit or not can_reject:
            return OutlierSolution(result, mask, tuple(reasons), errors)
        mask[worst] = False
        reasons[worst] = f"{error_name} {length:.3g}, more than {limit:g}"


def solve_robustly(
    solve: Callable[[Floats], tuple[R, Floats]], size: int, loss: str
) -> tuple[R, Floats, Floats]:
    """Solve with each datum weighted by a loss of its error, one of LOSSES for three coordinates.

    `solve` takes weights (size,) and returns the result and the weighted error of each datum, the
    root mean square of its coordinates. Returned are the result, the weights and the unweighted
    errors (size,) in deviations.
    """
    weights = np.ones(size)
    for _ in range(1 if loss == SQUARE else REWEIGHTINGS):
        result, errors = solve(weights)
        errors = errors / np.sqrt(weights)
        if loss != SQUARE:
            weights = LOSSES[loss].weight(3.0 * errors**2)
    return result, weights, errors
