"""Conversion between ROS messages, of rclpy or rosbags, and plain values.

Times are integer nanoseconds: a float of seconds since the epoch resolves only 240 ns.
"""

from collections.abc import Iterator
from itertools import zip_longest
from math import atan2, cos, isfinite, nan, sin
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped

from fss_arm_model.units import SECOND as SECOND

TURN_RATE = 4 + 9 + 2  # index of the rate about z among the doubles of an Imu


class PoseError(ValueError):
    """A pose is unusable: the subject was occluded, or a number is not finite."""


def stamp_ns(stamp: Any) -> int:
    """Convert a builtin_interfaces/Time to nanoseconds."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def to_time(ns: int) -> Time:
    """Convert nanoseconds to a builtin_interfaces/Time."""
    sec, nanosec = divmod(int(ns), SECOND)
    return Time(sec=sec, nanosec=nanosec)


def seconds(ns: int) -> float:
    """Convert nanoseconds to seconds."""
    return ns / SECOND


def joint_readings(message: Any) -> Iterator[tuple[int, float, float, float]]:
    """Yield number i, q [rad], qd [rad/s] and effort [N m] of each joint_<i> of a JointState.

    Joints with other names are skipped; missing values are NaN. Only the first nine digits of a
    number are read, because int() raises an error for thousands of digits.
    """
    values = message.position, message.velocity, message.effort
    for name, *reading in zip_longest(message.name, *values, fillvalue=nan):
        kind, _, number = str(name).partition("_")
        if kind == "joint" and number.isdecimal():
            q, qd, effort = map(float, reading)
            yield int(number[:9]), q, qd, effort


def planar_pose(pose: Any) -> tuple[float, float, float]:
    """Return x [m], y [m] and heading [rad] in (-pi, pi] of a geometry_msgs/Pose.

    The heading is the direction of the rotated x axis; the quaternion need not have unit length.

    Raises:
        PoseError: a zero quaternion, which receivers publish for an occluded subject, or a number
            that is not finite.
    """
    p, o = pose.position, pose.orientation
    if not all(map(isfinite, (p.x, p.y, p.z, o.x, o.y, o.z, o.w))):
        raise PoseError(f"pose is not finite: position {p.x, p.y, p.z}")
    if o.x * o.x + o.y * o.y + o.z * o.z + o.w * o.w < 0.25:
        raise PoseError("pose has no orientation: the subject is occluded")
    heading = atan2(2.0 * (o.w * o.z + o.x * o.y), o.w * o.w + o.x * o.x - o.y * o.y - o.z * o.z)
    return float(p.x), float(p.y), heading


def seen_pose(message: Any) -> tuple[float, float, float] | None:
    """Return the planar pose of a geometry_msgs/PoseStamped; None if the subject is not visible."""
    try:
        return planar_pose(message.pose)
    except PoseError:
        return None


def pose_stamped(
    ns: int, frame_id: str, pose: tuple[float, float, float], z: float = 0.0
) -> PoseStamped:
    """Return a planar pose (x [m], y [m], heading [rad]) at height z [m] as a message."""
    x, y, heading = map(float, pose)
    message = PoseStamped()
    message.header.stamp = to_time(ns)
    message.header.frame_id = frame_id
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, float(z)
    message.pose.orientation.z = sin(0.5 * heading)
    message.pose.orientation.w = cos(0.5 * heading)
    return message
