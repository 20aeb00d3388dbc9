"""How far the encoders' counts can move what a kinematic calibration finds."""

import numpy as np
import numpy.typing as npt

from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_model.arrays import Floats
from fss_arm_model.kinematics import reading_jacobian


def quantization_bound(
    problem: KinematicProblem, half_count: float, values: npt.ArrayLike | None = None
) -> Floats:
    """How far readings off by up to `half_count` can move the parameters, to first order, (p,).

    If the readings are q + e while the poses are exact, the fit obeys Phi dxi + Phi_q e = 0 in the
    weighted least squares sense, Phi_q holding the poses' derivatives by each reading, so that

        dxi = -Phi^+ Phi_q e
        |dxi_j| <= half_count * sum_k |(Phi^+ Phi_q)_jk|        for all |e_k| <= half_count

    with equality for the worst signs of e. A reading enters as its joint's offset does, therefore
    Phi_q takes the columns of theta_BJ1, theta_0_2 .. theta_0_n, each observation's own.
    Second-order terms are of the size of half_count^2 [m, rad]: 1e-10 for 240,000 counts a turn.

    Args:
        problem: the observations; its deviations are the weights.
        half_count: largest error of a reading [rad]: half an encoder count, pi / counts_per_turn,
            plus what the joint may move within the rest beside its average.
        values: (p,) where to linearize, the problem's initial guess by default.

    Returns:
        (p,) bound of each parameter's error, in its unit.
    """
    n, s = problem.arm.n, len(problem.q)
    xi = problem.guess if values is None else np.asarray(values, dtype=float)
    Phi_q = np.zeros((s, 3, s, n))
    Phi_q[np.arange(s), :, np.arange(s), :] = problem.whitening @ reading_jacobian(
        model.vector(problem, xi), problem.q
    )
    influence = np.linalg.pinv(model.regressor(problem, xi)) @ Phi_q.reshape(3 * s, s * n)
    return half_count * np.sum(np.abs(influence), axis=1)
