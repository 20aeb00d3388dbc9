"""The masses, centres of mass and inertias that fit the maneuvers best (Eq. 9)."""

import numpy as np

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.result import DynamicResult
from fss_arm_calib.estimation.least_squares import Floats, Indices, Linear, minimize, minimize_all

TOLERANCE = 1e-7  # of the last update [deviations]

DRAWS = 128  # that are solved side by side: as many as the processor's caches hold

FIRST = 2  # iterations of the maneuvers' own unknowns alone


def underway(problem: DynamicProblem) -> Floats:
    """The unknowns to begin with: the guess, and what each maneuver then must have begun with.

    The guess of a momentum is rest. Were the base to turn by radians more than that, the first step
    of the parameters would lead far astray.
    """
    x = problem.start
    hold = np.zeros((*x.shape[:-1], len(problem.names)))
    for _ in range(FIRST if (problem.own >= 3).any() else 0):
        extend = problem.linearize(x).extend
        x = x + extend(hold) if extend else x
    return x


def solve(
    problem: DynamicProblem, bounded: bool = True, tolerance: float = TOLERANCE
) -> DynamicResult:
    """Iterate Eq. 9 from the guess.

    Parameters that the data cannot tell apart stay as near to the guess as the others allow; the
    result names them.

    Args:
        problem: the maneuvers and what is known.
        bounded: keep to problem.bounds; deviations are true where none is active.
        tolerance: the update below which it has converged, in the parameter's deviations.
    """
    return DynamicResult(
        problem,
        minimize(
            problem.linearize, underway(problem), problem.bounds if bounded else None, tolerance
        ),
    )


def solve_all(problem: DynamicProblem, poses: Floats, bounded: bool = True) -> list[DynamicResult]:
    """What `solve` finds of each of many draws of the poses, (N, M, m, 3), as in a Monte Carlo."""
    found = []
    for begin in range(0, len(poses), DRAWS):
        # By the last ones: what has been found of the problem stays found.
        some = problem = problem.seeing(poses[begin : begin + DRAWS])

        def linearize(x: Floats, which: Indices, some: DynamicProblem = some) -> Linear:
            return some.seeing(some.poses[which]).linearize(x)

        bounds = some.bounds if bounded else None
        minima = minimize_all(linearize, underway(some), bounds, TOLERANCE)
        for one, minimum in zip(some.poses, minima, strict=True):
            own = some.seeing(one)
            found.append(DynamicResult(own, minimum) if minimum else solve(own, bounded))
    return found
