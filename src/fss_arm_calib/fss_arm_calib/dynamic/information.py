"""Information of maneuvers before they are solved, and the resulting covariance."""

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_model.arrays import Floats


def information(problem: DynamicProblem, unknowns: npt.ArrayLike | None = None) -> Floats:
    """Return Phi' W Phi of the observations, without the priors.

    The unknowns of each maneuver are eliminated.

    Returns:
        (M, p + c, p + c) information on estimated and assumed parameters for each maneuver. The
        information of several maneuvers is the sum.
    """
    x = problem.start if unknowns is None else np.asarray(unknowns, dtype=float)
    columns = np.concatenate([problem.to_model, problem.uncertain_to_model], axis=1)
    Phi = problem.eliminate_states(x, columns).regressor
    Phi = Phi.reshape(len(problem.poses), -1, columns.shape[1])
    return np.asarray(np.swapaxes(Phi, 1, 2) @ Phi)


def propagate_covariance(problem: DynamicProblem, total: Floats) -> Floats:
    """Return the covariance (..., p, p) of an estimate, with that of the assumed parameters.

    Args:
        problem: the estimated parameters and the prior knowledge.
        total: (..., p + c, p + c) information of all observations. It need not be regular by
            itself, only together with the priors.
    """
    p, rows, S = len(problem.names), problem.prior_rows, problem.uncertain
    random = np.linalg.inv(total[..., :p, :p] + rows.T @ rows)
    influence = random @ total[..., :p, p:]
    shared = random @ (rows.T @ problem.prior_with(S)) @ np.swapaxes(influence, -1, -2)
    moved = influence @ problem.assumed[np.ix_(S, S)] @ np.swapaxes(influence, -1, -2)
    return np.asarray(random + moved - shared - np.swapaxes(shared, -1, -2))
