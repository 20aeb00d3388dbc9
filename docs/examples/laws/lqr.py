"""LQR law: keep the base at its reference with the least cost, and the joints at rest.

With the arm at rest, base and arm are one body, whose inertia M (3, 3) about the base's origin
follows from the description and the joints' angles. For the error e = (pose, twist) and w = M u

    e' = A e + B u,   u = -K e,   cost = integral of e' Q e + u' R u

in discrete time, with the gain K from the algebraic Riccati equation (scipy.linalg).
"""

import numpy as np
from scipy.linalg import solve_discrete_are

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.planar import wrap
from fss_gnc.law import Inputs, Outputs

# Sizes at which errors and accelerations cost the same (Bryson's rule).
POSE_ERROR = np.array([0.02, 0.02, 0.05])  # [m, m, rad]
TWIST_ERROR = np.array([0.02, 0.02, 0.05])  # [m/s, m/s, rad/s]
ACCELERATION = np.array([0.004, 0.004, 0.008])  # [m/s^2, m/s^2, rad/s^2]
MAX_ERROR = np.array([0.03, 0.03, 0.05])  # above it the wrench does not increase [m, m, rad]


class Lqr:
    """LQR of the base.

    Args:
        joints: number of joints.
        period: nominal time between two steps [s].
    """

    def __init__(self, joints: int, period: float) -> None:
        self.parameters = paper_arm().vector()
        self.gain = lqr_gain(period)

    def step(self, inputs: Inputs) -> Outputs:
        """Return the commands for the next period."""
        error = np.concatenate(
            [inputs.base_pose - inputs.reference_pose, inputs.base_twist - inputs.reference_twist]
        )
        error[2] = wrap(error[2])
        error[:3] = np.clip(error[:3], -MAX_ERROR, MAX_ERROR)
        acceleration = inputs.reference_acceleration - self.gain @ error
        q = np.concatenate([inputs.base_pose, inputs.joint_angles])
        wrench = inertia_matrix(self.parameters, q)[:3, :3] @ acceleration
        c, s = np.cos(q[2]), np.sin(q[2])
        to_base = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return Outputs(wrench=to_base @ wrench, joint_velocities=np.zeros(inputs.joints))


def lqr_gain(period: float) -> np.ndarray:
    """Return K (3, 6) of three double integrators, sampled with a period [s]."""
    one, zero = np.eye(3), np.zeros((3, 3))
    a = np.block([[one, period * one], [zero, one]])
    b = np.vstack([0.5 * period**2 * one, period * one])
    q = np.diag(1.0 / np.concatenate([POSE_ERROR, TWIST_ERROR]) ** 2)
    r = np.diag(1.0 / ACCELERATION**2)
    p = solve_discrete_are(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
