"""The base's estimated state as messages."""

from math import cos, sin

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

from fss_arm_ros.convert import to_time

from .base_filter import BaseState


def odometry(state: BaseState, world_frame: str, base_frame: str) -> Odometry:
    """Pose in the world, twist along the base's own axes, as the type has it."""
    message = Odometry()
    message.header.stamp = to_time(state.t)
    message.header.frame_id, message.child_frame_id = world_frame, base_frame
    x, y, heading = map(float, state.pose)
    vx, vy, omega = map(float, state.twist)
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = sin(0.5 * heading)
    message.pose.pose.orientation.w = cos(0.5 * heading)
    message.twist.twist.linear.x = cos(heading) * vx + sin(heading) * vy
    message.twist.twist.linear.y = cos(heading) * vy - sin(heading) * vx
    message.twist.twist.angular.z = omega
    for k, i in enumerate((0, 7, 35)):  # x, y and heading, on the diagonal of 6 x 6
        message.pose.covariance[i] = float(state.pose_variance[k])
        message.twist.covariance[i] = float(state.twist_variance[k])
    return message


def transform(state: BaseState, world_frame: str, base_frame: str) -> TFMessage:
    """From the world to the base."""
    message = TransformStamped()
    message.header.stamp = to_time(state.t)
    message.header.frame_id, message.child_frame_id = world_frame, base_frame
    x, y, heading = map(float, state.pose)
    message.transform.translation.x, message.transform.translation.y = x, y
    message.transform.rotation.z = sin(0.5 * heading)
    message.transform.rotation.w = cos(0.5 * heading)
    return TFMessage(transforms=[message])
