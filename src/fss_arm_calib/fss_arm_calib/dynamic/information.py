"""How much maneuvers tell before anything is solved, and how well parameters then are known."""

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.estimation.least_squares import Floats


def information(problem: DynamicProblem, unknowns: npt.ArrayLike | None = None) -> Floats:
    """Phi' W Phi of the observations alone, priors left out, each maneuver's own unknowns gone.

    Returns:
        (M, p + c, p + c), by the parameters and what is assumed, for each maneuver: they add up.
    """
    x = problem.start if unknowns is None else np.asarray(unknowns, dtype=float)
    columns = np.concatenate([problem.to_model, problem.by_unsure], axis=1)
    Phi = problem.reduced(x, columns).regressor
    Phi = Phi.reshape(len(problem.poses), -1, columns.shape[1])
    return np.asarray(np.swapaxes(Phi, 1, 2) @ Phi)


def propagated(problem: DynamicProblem, total: Floats) -> Floats:
    """Covariance (..., p, p) of what would be estimated, with the uncertainty of what is assumed.

    Args:
        problem: what is estimated, and known beforehand.
        total: (..., p + c, p + c) information of all observations; with the priors it is regular.
    """
    p, rows, S = len(problem.names), problem.prior_rows, problem.unsure
    random = np.linalg.inv(total[..., :p, :p] + rows.T @ rows)
    influence = random @ total[..., :p, p:]
    shared = random @ (rows.T @ problem.prior_with(S)) @ np.swapaxes(influence, -1, -2)
    moved = influence @ problem.assumed[np.ix_(S, S)] @ np.swapaxes(influence, -1, -2)
    return np.asarray(random + moved - shared - np.swapaxes(shared, -1, -2))
