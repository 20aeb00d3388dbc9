"""Solver for the masses, centres of mass and inertias that fit the maneuvers best (Eq. 9)."""

import numpy as np

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.result import DynamicResult
from fss_arm_calib.estimation.least_squares import minimize
from fss_arm_model.arrays import Floats

TOLERANCE = 1e-7  # largest last update [deviations]

STATE_ITERATIONS = 2  # first iterations, of only the maneuvers' own unknowns


def initial_unknowns(problem: DynamicProblem) -> Floats:
    """Return the initial unknowns: the guess, and the matching initial states of the maneuvers.

    The guess of a momentum is zero. If the base turned by radians more than this predicts, the
    first step of the parameters would diverge. So the maneuvers' own unknowns are updated first.
    """
    x = problem.start
    hold = np.zeros(len(problem.names))
    for _ in range(STATE_ITERATIONS if (problem.state_unknowns >= 3).any() else 0):
        extend = problem.linearize(x).extend
        x = x + extend(hold) if extend else x
    return x


def solve(
    problem: DynamicProblem, bounded: bool = True, tolerance: float = TOLERANCE
) -> DynamicResult:
    """Iterate Eq. 9 from the guess.

    Parameters that are not identifiable stay as near to the guess as the others allow. The result
    names them.

    Args:
        problem: the maneuvers and the prior knowledge.
        bounded: keep to problem.bounds; deviations are correct only if no bound is active.
        tolerance: update below which the iteration has converged, in standard deviations.
    """
    return DynamicResult(
        problem,
        minimize(
            problem.linearize,
            initial_unknowns(problem),
            problem.bounds if bounded else None,
            tolerance,
        ),
    )
