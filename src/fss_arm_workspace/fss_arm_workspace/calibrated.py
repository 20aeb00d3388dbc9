"""The arm as calibrations left it, from their messages: rclpy's and rosbags' alike."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fss_arm_model.description import Arm, from_yaml, kinematic_index

from .arcs import Floats
from .uncertainty import vector_covariance

TOPICS = {
    "calibration/kinematic": "fss_arm_msgs/msg/KinematicCalibration",
    "calibration/dynamic": "fss_arm_msgs/msg/DynamicCalibration",
}


@dataclass(frozen=True)
class Calibrated:
    """An arm, and how well it is known: kinematics by one calibration, dynamics by another."""

    arm: Arm
    kinematic: Floats | None = None  # covariance of Arm.vector(); None: taken as exact
    dynamic: Floats | None = None

    @property
    def covariance(self) -> Floats:
        """Of Arm.vector(), (8 + 6 n, 8 + 6 n)."""
        size = len(self.arm.vector())
        known = [C for C in (self.kinematic, self.dynamic) if C is not None]
        return np.sum([np.zeros((size, size)), *known], axis=0)

    def with_message(self, topic: str, message: Any) -> "Calibrated":
        """What is known after a calibration: all that one tells if it passed, else the same.

        A kinematic calibration knows nothing of masses, and those known before are kept.

        Raises:
            DescriptionError: the calibrated description cannot be right.
            ValueError: a parameter is not the arm's.
        """
        if message.verdict != "pass":
            return self
        arm = from_yaml(message.description)
        C = vector_covariance(arm, message.names, message.covariance) if message.names else None
        if topic.endswith("dynamic"):
            return Calibrated(arm, self.kinematic, C)
        if self.dynamic is not None and arm.n == self.arm.n:
            kinematics = arm.vector()[kinematic_index(arm.n)]
            arm = replace(self.arm.with_kinematics(kinematics), theta_E=arm.theta_E)
            return Calibrated(arm, C, self.dynamic)
        return Calibrated(arm, C)
