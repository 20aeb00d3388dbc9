"""Solver for the masses, centres of mass and inertias that fit the maneuvers best (Eq. 9)."""

import numpy as np

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.result import DynamicResult
from fss_arm_calib.estimation.least_squares import Floats, Indices, Linear, minimize, minimize_all

TOLERANCE = 1e-7  # largest last update [deviations]

BATCH_SIZE = 128  # draws solved in one batch, limited by the processor's caches

STATE_ITERATIONS = 2  # first iterations, of only the maneuvers' own unknowns


def initial_unknowns(problem: DynamicProblem) -> Floats:
    """Return the initial unknowns: the guess, and the matching initial states of the maneuvers.

    The guess of a momentum is zero. If the base turned by radians more than this predicts, the
    first step of the parameters would diverge. So the maneuvers' own unknowns are updated first.
    """
    x = problem.start
    hold = np.zeros((*x.shape[:-1], len(problem.names)))
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


def solve_all(problem: DynamicProblem, poses: Floats, bounded: bool = True) -> list[DynamicResult]:
    """Solve as `solve` does for N draws of the poses, (N, M, m, 3), as in a Monte Carlo study."""
    found = []
    for begin in range(0, len(poses), BATCH_SIZE):
        # Derived from the previous batch, so that cached values of the problem are reused.
        some = problem = problem.with_poses(poses[begin : begin + BATCH_SIZE])

        def linearize(x: Floats, which: Indices, some: DynamicProblem = some) -> Linear:
            return some.with_poses(some.poses[which]).linearize(x)

        bounds = some.bounds if bounded else None
        minima = minimize_all(linearize, initial_unknowns(some), bounds, TOLERANCE)
        for one, minimum in zip(some.poses, minima, strict=True):
            own = some.with_poses(one)
            found.append(DynamicResult(own, minimum) if minimum else solve(own, bounded))
    return found
