"""The estimated state of a body as messages."""

from math import cos, sin

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

from fss_arm_ros.serialized import SerializedMessage

from .body_filter import BodyState

COVARIANCE, TWIST, TWIST_COVARIANCE = 7, 43, 49  # where they begin among an Odometry's doubles
PLANE = 0, 1, 5  # x, y and heading among six


class SerializedState(SerializedMessage):
    """Pose in the world, twist along the body's own axes, as the type has it, with covariances."""

    def __init__(self, world_frame: str, body_frame: str) -> None:
        message = Odometry(child_frame_id=body_frame)
        message.header.frame_id = world_frame
        super().__init__(message, 85)

    def of(self, state: BodyState) -> bytes:
        """A state."""
        x, y, heading = state.pose.tolist()
        vx, vy, omega = state.twist.tolist()
        c, s = cos(heading), sin(heading)
        own = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self.stamped(state.t)
        self.put(0, x, y, 0.0, 0.0, 0.0, sin(0.5 * heading), cos(0.5 * heading))
        self.put(TWIST, c * vx + s * vy, c * vy - s * vx, 0.0, 0.0, 0.0, omega)
        twist = own @ state.covariance[3:, 3:] @ own.T
        for begin, block in ((COVARIANCE, state.covariance[:3, :3]), (TWIST_COVARIANCE, twist)):
            for i, (a, b, d) in zip(PLANE, block.tolist(), strict=True):
                self.put(begin + 6 * i, a, b, 0.0, 0.0, 0.0, d)
        return self.bytes()


class SerializedTransform(SerializedMessage):
    """From the world to the body, for /tf."""

    def __init__(self, world_frame: str, body_frame: str) -> None:
        message = TransformStamped(child_frame_id=body_frame)
        message.header.frame_id = world_frame
        super().__init__(TFMessage(transforms=[message]), 7, stamp=8)

    def of(self, state: BodyState) -> bytes:
        """A state."""
        x, y, heading = state.pose.tolist()
        self.stamped(state.t)
        self.put(0, x, y, 0.0, 0.0, 0.0, sin(0.5 * heading), cos(0.5 * heading))
        return self.bytes()
