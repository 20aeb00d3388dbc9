"""Conversion of estimates to messages."""

from math import cos, sin

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

from fss_arm_model.thrusters import THRUSTER_COUNT
from fss_arm_msgs.msg import MassProperties, ThrusterHealth
from fss_arm_ros.convert import to_time

from .body_filter import BodyState
from .mass_estimator import MassProperties as MassEstimate
from .valve_faults import Faults

PLANE = (0, 1, 5)  # x, y and heading among the six axes of a covariance


def odometry(state: BodyState, world_frame: str, body_frame: str) -> Odometry:
    """Return an Odometry: pose in the world, twist in the body's axes."""
    x, y, heading = state.pose.tolist()
    vx, vy, omega = state.twist.tolist()
    c, s = cos(heading), sin(heading)
    to_body = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    message = Odometry(child_frame_id=body_frame)
    message.header.stamp, message.header.frame_id = to_time(state.t), world_frame
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = sin(0.5 * heading), cos(0.5 * heading)
    twist.linear.x, twist.linear.y, twist.angular.z = c * vx + s * vy, c * vy - s * vx, omega
    message.pose.covariance = _in_space(state.covariance[:3, :3])
    message.twist.covariance = _in_space(to_body @ state.covariance[3:, 3:] @ to_body.T)
    return message


def _in_space(covariance: np.ndarray) -> np.ndarray:
    """Return a planar covariance (3, 3) as the 36 numbers of a covariance of six axes."""
    whole = np.zeros((6, 6))
    whole[np.ix_(PLANE, PLANE)] = covariance
    return whole.ravel()


def transform(state: BodyState, world_frame: str, body_frame: str) -> TFMessage:
    """Return the transform from the world to the body, for /tf."""
    x, y, heading = state.pose.tolist()
    one = TransformStamped(child_frame_id=body_frame)
    one.header.stamp, one.header.frame_id = to_time(state.t), world_frame
    one.transform.translation.x, one.transform.translation.y = x, y
    one.transform.rotation.z, one.transform.rotation.w = sin(0.5 * heading), cos(0.5 * heading)
    return TFMessage(transforms=[one])


def mass_properties(found: MassEstimate, samples: int, stamp: int, frame_id: str) -> MassProperties:
    """Return the mass properties of the held body, in the last link's frame, at a time [ns]."""
    mass, *com, inertia = found.values.tolist()
    message = MassProperties(
        mass=mass, com=com, inertia=inertia, covariance=found.covariance.ravel(), samples=samples
    )
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message


def thruster_health(faults: Faults, stamp: int, frame_id: str) -> ThrusterHealth:
    """Return the ThrusterHealth message of the valves' faults at a time [ns]."""
    message = ThrusterHealth(
        stuck_open=[i in faults.open for i in range(THRUSTER_COUNT)],
        stuck_closed=[i in faults.closed for i in range(THRUSTER_COUNT)],
        pushed=faults.unknown_push,
    )
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message
