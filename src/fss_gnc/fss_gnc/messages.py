"""Conversion of the messages that control and guidance receive and publish."""

from math import atan2, cos, hypot, isfinite, sin
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion, Transform, Twist, Vector3
from rclpy.duration import Duration
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, joint_names
from fss_arm_model.held import Target
from fss_arm_ros.convert import SECOND, PoseError, joint_readings, planar_pose, stamp_ns, to_time
from fss_gnc import bounds
from fss_gnc.reference import Body, Path

BASE, WORLD = "fss", "world"  # name of the one "joint" of a base trajectory, and its frame
HEIGHT_RANGE = (-10.0, 10.0)  # allowed heights of a base's origin, ignored by control [m]
MAX_TILT = 0.1  # of the base's z axis [rad]
END_MARGIN = 1e-6  # from the last point of a message to the end of its path [s]
MAX_OUT_OF_PLANE = 1e-3  # allowed motion out of the plane [m/s, rad/s, m/s^2, rad/s^2]
MAX_OVERSPEED = 3.0  # planned rate of a joint, as a multiple of its drive's max_velocity


def body(message: Any) -> Body:
    """Return the pose and twist of an Odometry in the world; its twist is in the body's axes.

    Raises:
        PoseError: a number is not finite, or the pose is invalid.
    """
    pose = np.array(planar_pose(message.pose.pose))
    v, c, s = message.twist.twist, cos(pose[2]), sin(pose[2])
    twist = c * v.linear.x - s * v.linear.y, s * v.linear.x + c * v.linear.y, v.angular.z
    if not all(map(isfinite, twist)):
        raise PoseError(f"twist is not finite: {twist}")
    return Body(pose, np.array(twist))


def joints(message: Any, n: int) -> Floats:
    """Return angles, rates and efforts (3, n) of a JointState with all joints; efforts may be NaN.

    Raises:
        ValueError: joints are missing, or a number is not finite.
    """
    rows = sorted(joint_readings(message))
    if [row[0] for row in rows] != list(range(1, n + 1)):
        raise ValueError(f"joints are {[row[0] for row in rows]}, expected 1 to {n}")
    found = np.array([row[1:] for row in rows]).T
    if not np.isfinite(found[:2]).all():
        raise ValueError("an angle or a rate is not finite")
    return found


def mass_properties(message: Any) -> tuple[Target, Floats]:
    """Return MassProperties as a body and its place (3,) in the last link's frame (held.py).

    Raises:
        ValueError: the values are not those of a body.
    """
    place = np.array([*message.com, 0.0])
    if not np.isfinite(place).all():
        raise ValueError(f"com is {message.com}, must be finite")
    return Target(message.mass, message.inertia), place


def planned_rates(message: Any, arm: Arm) -> tuple[int, Floats, Floats]:
    """Return stamp [ns], times since (k,) [s] and rates (k, n) [rad/s] of a JointTrajectory.

    Raises:
        ValueError: a name, a number or a count does not fit this arm; the message names it.
    """
    names, points = joint_names(arm.n), message.points
    if list(message.joint_names) != names:
        raise ValueError(f"joint_names is {_abbreviate(message.joint_names)}, expected {names}")
    if not points:
        raise ValueError("there are no points, expected one or more")
    for k, point in enumerate(points):
        if (count := len(point.velocities)) != arm.n:
            raise ValueError(f"points[{k}] has {count} velocities, expected {arm.n}")
    times = np.array([stamp_ns(point.time_from_start) for point in points]) / SECOND
    bounds.check_duration("points[0].time_from_start", float(times[0]))
    if (np.diff(times) <= 0.0).any():
        raise ValueError("time_from_start must increase from point to point")
    rates = np.array([point.velocities for point in points])
    max_rates = MAX_OVERSPEED * np.array([link.drive.max_velocity for link in arm.links])
    bounds.check_all(
        rates,
        np.broadcast_to(max_rates, rates.shape),
        lambda k, i: (f"points[{k}].velocities[{i}]", "rad/s"),
    )
    return stamp_ns(message.header.stamp), times, rates


def trajectory(path: Path | None, t: float, stamp: int, horizon: float, step: float) -> Any:
    """Return a message with a path from its time t on; no points if there is no path.

    Args:
        path: of the base, or None.
        t: present time on the path [s].
        stamp: of the message [ns].
        horizon: length of the published part [s].
        step: between two points [s].
    """
    message = MultiDOFJointTrajectory(joint_names=[BASE])
    message.header.stamp, message.header.frame_id = to_time(stamp), WORLD
    if path is not None:
        # A path that ends in motion is at rest from its end on: the last point is just before it.
        last = max(0.0, min(horizon, path.end_time - t) - END_MARGIN)
        times = np.append(np.arange(0.0, last - END_MARGIN, step), last).tolist()
        message.points = [_point(path, t, ahead) for ahead in times]
    return message


def _point(path: Path, t: float, ahead: float) -> MultiDOFJointTrajectoryPoint:
    r = path.at(t + ahead)
    x, y, heading = map(float, r.pose)
    turn = Quaternion(z=sin(0.5 * heading), w=cos(0.5 * heading))
    return MultiDOFJointTrajectoryPoint(
        transforms=[Transform(translation=Vector3(x=x, y=y), rotation=turn)],
        velocities=[_planar(r.twist)],
        accelerations=[_planar(r.acceleration)],
        time_from_start=Duration(seconds=ahead).to_msg(),
    )


def _planar(values: Floats) -> Twist:
    x, y, turn = map(float, values)
    return Twist(linear=Vector3(x=x, y=y), angular=Vector3(z=turn))


def path(message: Any) -> Path | None:
    """Return a MultiDOFJointTrajectory of the base as a path; None if it has no points.

    The times of the path are seconds since the stamp.

    Raises:
        ValueError: it is not a planar path in the world; the message names the fault.
    """
    if list(message.joint_names) != [BASE]:
        raise ValueError(f"joint_names is {_abbreviate(message.joint_names)}, expected ['{BASE}']")
    if (frame := message.header.frame_id) != WORLD:
        raise ValueError(f"frame_id is {frame[:40]!r}, expected {WORLD!r}")
    if not message.points:
        return None
    given = [(p.transforms, p.velocities, p.accelerations) for p in message.points]
    counts = {tuple(len(part) for part in parts) for parts in given}
    if counts not in ({(1, 0, 0)}, {(1, 1, 0)}, {(1, 1, 1)}):
        raise ValueError(
            "each point must have one transform; all points or none must have one velocity, and "
            "only then one acceleration each"
        )
    for k, parts in enumerate(given):
        _check_planar(f"points[{k}]", *(part[0] for part in parts if len(part)))
    times = [stamp_ns(point.time_from_start) / SECOND for point in message.points]
    knots = np.array([[_pose(x[0]), *(_twist(one) for one in (*v, *a))] for x, v, a in given])
    knots[:, 0, 2] = np.unwrap(knots[:, 0, 2])
    return Path(np.array(times), knots)


def _check_planar(name: str, transform: Any, *twists: Any) -> None:
    """Raise ValueError if a point has height, tilt or motion out of the table's plane."""
    bounds.check(f"{name}.transforms[0].translation.z", transform.translation.z, *HEIGHT_RANGE, "m")
    r = transform.rotation
    tilt = 2.0 * atan2(hypot(r.x, r.y), hypot(r.z, r.w))
    bounds.check(f"tilt of {name}.transforms[0].rotation", tilt, 0.0, MAX_TILT, "rad")
    parts = ("velocities", "/s"), ("accelerations", "/s^2")
    for (part, per), twist in zip(parts, twists, strict=False):
        for field, value, unit in (
            ("linear.z", twist.linear.z, "m"),
            ("angular.x", twist.angular.x, "rad"),
            ("angular.y", twist.angular.y, "rad"),
        ):
            bounds.check(
                f"{name}.{part}[0].{field}", value, -MAX_OUT_OF_PLANE, MAX_OUT_OF_PLANE, unit + per
            )


def _pose(transform: Any) -> tuple[float, float, float]:
    class Pose:
        position, orientation = transform.translation, transform.rotation

    return planar_pose(Pose)


def _twist(twist: Any) -> tuple[float, float, float]:
    return twist.linear.x, twist.linear.y, twist.angular.z


def _abbreviate(names: Any) -> str:
    """Return the names of joints for an error message, shortened."""
    return str(list(names[:8]))[:80]
