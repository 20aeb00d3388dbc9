"""Between ROS messages and plain values, by attribute: rclpy's and rosbags' messages both pass.

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
    """A pose says nothing: the subject was occluded, or a number is not finite."""


def stamp_ns(stamp: Any) -> int:
    """A builtin_interfaces/Time as nanoseconds."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def to_time(ns: int) -> Time:
    """Nanoseconds as a builtin_interfaces/Time."""
    sec, nanosec = divmod(int(ns), SECOND)
    return Time(sec=sec, nanosec=nanosec)


def seconds(ns: int) -> float:
    """A difference of nanoseconds in seconds."""
    return ns / SECOND


def joint_readings(message: Any) -> Iterator[tuple[int, float, float, float]]:
    """Number i, q [rad], qd [rad/s] and effort [N m] of each joint_<i> of a JointState.

    Other joints are left out; what the message leaves out is NaN. Of a number of more than nine
    digits the first nine are given: no arm has so many joints, and int() refuses thousands.
    """
    values = message.position, message.velocity, message.effort
    for name, *reading in zip_longest(message.name, *values, fillvalue=nan):
        kind, _, number = str(name).partition("_")
        if kind == "joint" and number.isdecimal():
            q, qd, effort = map(float, reading)
            yield int(number[:9]), q, qd, effort


def planar_pose(pose: Any) -> tuple[float, float, float]:
    """A geometry_msgs/Pose seen from above: x [m], y [m], heading [rad] in (-pi, pi].

    The heading is that of the rotated x axis, which needs no unit quaternion.

    Raises:
        PoseError: the zero pose that receivers publish for an occluded subject, a quaternion
            that turns nothing, or a number that is not finite.
    """
    p, o = pose.position, pose.orientation
    if not all(map(isfinite, (p.x, p.y, p.z, o.x, o.y, o.z, o.w))):
        raise PoseError(f"pose is not finite: position {p.x, p.y, p.z}")
    if o.x * o.x + o.y * o.y + o.z * o.z + o.w * o.w < 0.25:
        raise PoseError("pose has no orientation: the subject is occluded")
    heading = atan2(2.0 * (o.w * o.z + o.x * o.y), o.w * o.w + o.x * o.x - o.y * o.y - o.z * o.z)
    return float(p.x), float(p.y), heading


def seen_pose(message: Any) -> tuple[float, float, float] | None:
    """The planar pose in a geometry_msgs/PoseStamped; None: the subject was not visible."""
    try:
        return planar_pose(message.pose)
    except PoseError:
        return None


def pose_stamped(
    ns: int, frame_id: str, pose: tuple[float, float, float], z: float = 0.0
) -> PoseStamped:
    """A planar pose (x [m], y [m], heading [rad]) at height z [m] as a message."""
    x, y, heading = map(float, pose)
    message = PoseStamped()
    message.header.stamp = to_time(ns)
    message.header.frame_id = frame_id
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, float(z)
    message.pose.orientation.z = sin(0.5 * heading)
    message.pose.orientation.w = cos(0.5 * heading)
    return message
