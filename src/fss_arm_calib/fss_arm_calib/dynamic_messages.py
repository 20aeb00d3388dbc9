"""Between the dynamic calibration and ROS messages, rclpy's or rosbags' alike."""

from collections.abc import Sequence
from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np

from fss_arm_calib.dynamic.checks import DynamicCalibration
from fss_arm_calib.messages import plain, provenance_message, seen_pose, stage_message
from fss_arm_calib.segments.maneuvers import Maneuver, ManeuverFinder
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_msgs import msg
from fss_arm_ros.convert import joint_readings, stamp_ns, to_time

_ROWS = ("times", "q", "qd")  # of a Maneuver: one for each joint


def feed_joints(finder: ManeuverFinder, message: Any) -> list[Maneuver]:
    """Give a sensor_msgs/JointState to the finder; joints are told by their names, joint_<i>."""
    t, found = stamp_ns(message.header.stamp), []
    for i, q, qd, _ in joint_readings(message):
        found += finder.joint(i, t, q, qd)
    return found


def feed_pose(finder: ManeuverFinder, message: Any) -> list[Maneuver]:
    """Give a geometry_msgs/PoseStamped of the base to the finder."""
    return finder.pose(BASE, *seen_pose(message))


def feed_tip(finder: ManeuverFinder, message: Any) -> list[Maneuver]:
    """Give a geometry_msgs/PoseStamped of the end effector to the finder."""
    return finder.pose(TIP, *seen_pose(message))


def feed_gyro(finder: ManeuverFinder, message: Any) -> list[Maneuver]:
    """Give a sensor_msgs/Imu of the base to the finder."""
    return finder.rate(stamp_ns(message.header.stamp), float(message.angular_velocity.z))


def to_message(calibration: DynamicCalibration, frame_id: str) -> msg.DynamicCalibration:
    """What a calibration concludes, as it is published."""
    message = msg.DynamicCalibration()
    message.header.stamp = to_time(calibration.stamp)
    message.header.frame_id = frame_id
    message.provenance = provenance_message(calibration.provenance)
    message.stages = [stage_message(stage) for stage in calibration.stages]
    for name in set(message.get_fields_and_field_types()) - {"header", "provenance", "stages"}:
        setattr(message, name, plain(getattr(calibration, name)))
    return message


def maneuvers_message(maneuvers: Sequence[Maneuver], frame_id: str) -> msg.Maneuvers:
    """All maneuvers so far, as they are published."""
    message = msg.Maneuvers()
    message.header.frame_id = frame_id
    message.header.stamp = to_time(maneuvers[-1].end if maneuvers else 0)
    for maneuver in maneuvers:
        one = msg.Maneuver(samples=[len(times) for times in maneuver.times])
        for name in set(one.get_fields_and_field_types()) - {"samples"}:
            value = getattr(maneuver, name)
            if name in ("start", "end"):
                value = to_time(value)
            elif name in (*_ROWS, "poses"):
                value = [number for row in value for number in row]
            setattr(one, name, plain(value))
        message.maneuvers.append(one)
    return message


def maneuvers_of(message: Any) -> list[Maneuver]:
    """The maneuvers that a Maneuvers message holds."""
    return [_maneuver(one) for one in message.maneuvers]


def _maneuver(one: Any) -> Maneuver:
    edges = np.cumsum([0, *one.samples])

    def value(name: str) -> Any:
        given = getattr(one, name)
        if name in ("start", "end"):
            return stamp_ns(given)
        if name in _ROWS:
            rows = pairwise(edges)
            return tuple(tuple(map(float, given[a:b])) for a, b in rows)
        if name == "poses":
            return tuple(map(tuple, np.reshape(given, (-1, 3)).tolist()))
        if name in ("marks", "seconds", "tip"):
            return tuple(map(float, given))
        return tuple(map(int, given)) if name == "frames" else given

    # Older bags have no time_offset, or no tip.
    return Maneuver(**{f.name: value(f.name) for f in fields(Maneuver) if hasattr(one, f.name)})
