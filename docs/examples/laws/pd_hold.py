"""PD law: keep the base at its reference and the joints where they were at the start."""

from math import cos, pi, sin

import numpy as np

from fss_gnc.law import Inputs, Outputs

MASS, INERTIA = 20.0, 10.0  # of base and arm, stretched, about the base's origin [kg], [kg m^2]
STIFFNESS, DAMPING = 0.1, 0.6  # of the base per mass [1/s^2], [1/s]
# Errors above which the wrench does not increase, so that the valves can give it.
MAX_OFFSET, MAX_TURN = 0.03, 0.05  # [m], [rad]
JOINT_GAIN = 1.0  # rate of a joint per angle error [1/s]
MAX_RATE = 0.1  # of a joint [rad/s]


class PdHold:
    """PD law for the base, P law for the joints.

    Args:
        joints: number of joints.
        period: nominal time between two steps [s].
    """

    def __init__(self, joints: int, period: float) -> None:
        self.start: list[float] | None = None  # angles of the joints [rad]

    def step(self, inputs: Inputs) -> Outputs:
        """Return the commands for the next period."""
        wrench = base_wrench(
            inputs.base_pose.tolist(), inputs.base_twist.tolist(),
            inputs.reference_pose.tolist(), inputs.reference_twist.tolist(),
        )  # fmt: skip
        q = inputs.joint_angles.tolist()
        self.start = self.start or q
        rates = [
            limit(JOINT_GAIN * (q_0 - q_i), MAX_RATE)
            for q_0, q_i in zip(self.start, q, strict=True)
        ]
        return Outputs(wrench=np.array(wrench), joint_velocities=np.array(rates))


def base_wrench(
    pose: list[float], twist: list[float], desired: list[float], desired_twist: list[float]
) -> tuple[float, float, float]:
    """Return force along the base's axes [N] and torque [N m]."""
    error_x = limit(desired[0] - pose[0], MAX_OFFSET)
    error_y = limit(desired[1] - pose[1], MAX_OFFSET)
    turn = desired[2] - pose[2]
    turn = limit(turn - 2.0 * pi * round(turn / (2.0 * pi)), MAX_TURN)  # the shorter way
    a_x = STIFFNESS * error_x + DAMPING * (desired_twist[0] - twist[0])
    a_y = STIFFNESS * error_y + DAMPING * (desired_twist[1] - twist[1])
    a_turn = STIFFNESS * turn + DAMPING * (desired_twist[2] - twist[2])
    c, s = cos(pose[2]), sin(pose[2])
    return MASS * (c * a_x + s * a_y), MASS * (c * a_y - s * a_x), INERTIA * a_turn


def limit(value: float, bound: float) -> float:
    """Return the value nearest to `value` from -bound to bound."""
    return min(max(value, -bound), bound)
