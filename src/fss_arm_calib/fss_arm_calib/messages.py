"""Between the calibration and ROS messages, by attribute: rclpy's and rosbags' both pass."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from fss_arm_calib import acceptance as judgement
from fss_arm_calib.drift import checks as drift_verdict
from fss_arm_calib.kinematic.checks import Calibration
from fss_arm_calib.segments.rests import Observation, RestFinder
from fss_arm_msgs.msg import (
    FloatCalibration,
    KinematicCalibration,
    KinematicObservation,
    KinematicObservations,
    Provenance,
    Stage,
)
from fss_arm_ros.convert import PoseError, joint_readings, planar_pose, stamp_ns, to_time


def feed_joints(finder: Any, message: Any) -> list[Any]:
    """Give a sensor_msgs/JointState to a finder; joints are told by their names, joint_<i>."""
    t, found = stamp_ns(message.header.stamp), []
    for i, q, *_ in joint_readings(message):
        found += finder.joint(i, t, q)
    return found


def feed_telemetry(finder: Any, message: Any) -> list[Any]:
    """Give a LinkTelemetry to a finder: whether its link is armed, and how often it was homed."""
    t = stamp_ns(message.header.stamp)
    return finder.telemetry(
        int(message.link), t, bool(message.armed), int(message.boot), int(message.homings)
    )


def feed_pose(finder: RestFinder, subject: str, message: Any) -> list[Observation]:
    """Give a geometry_msgs/PoseStamped of a subject to the finder."""
    return finder.pose(subject, *seen_pose(message))


def seen_pose(message: Any) -> tuple[int, tuple[float, float, float] | None]:
    """Stamp [ns] and planar pose of a geometry_msgs/PoseStamped; None: it was not visible."""
    try:
        pose = planar_pose(message.pose)
    except PoseError:
        pose = None
    return stamp_ns(message.header.stamp), pose


def to_message(calibration: Calibration, frame_id: str) -> KinematicCalibration:
    """What a calibration concludes, as it is published."""
    message = KinematicCalibration()
    message.header.stamp = to_time(calibration.stamp)
    message.header.frame_id = frame_id
    message.provenance = provenance_message(calibration.provenance)
    message.stages = [stage_message(stage) for stage in calibration.stages]
    for name in set(message.get_fields_and_field_types()) - {"header", "provenance", "stages"}:
        setattr(message, name, plain(getattr(calibration, name)))
    return message


def provenance_message(provenance: judgement.Provenance) -> Provenance:
    """From what a result was computed."""
    known = {f.name: getattr(provenance, f.name) for f in fields(provenance)}
    return Provenance(**{k: to_time(v) if k in ("begin", "end") else v for k, v in known.items()})


def stage_message(stage: judgement.Stage) -> Stage:
    """One stage of a verdict."""
    return Stage(
        name=stage.name,
        verdict=stage.verdict,
        value=float(stage.value),
        threshold=float(stage.threshold),
        reason=stage.reason,
    )


def observations_message(
    observations: Sequence[Observation], frame_id: str, subject: str
) -> KinematicObservations:
    """All observations so far, as they are published."""
    message = KinematicObservations(subject=subject)
    message.header.frame_id = frame_id
    message.header.stamp = to_time(observations[-1].end if observations else 0)
    for observation in observations:
        one = KinematicObservation()
        for name in one.get_fields_and_field_types():
            value = getattr(observation, name)
            setattr(one, name, to_time(value) if name in ("start", "end") else plain(value))
        message.observations.append(one)
    return message


def float_message(calibration: drift_verdict.FloatCalibration, frame_id: str) -> FloatCalibration:
    """What a float concludes, as it is published, with its drifts."""
    c, message = calibration, FloatCalibration()
    message.header.stamp, message.header.frame_id = to_time(c.stamp), frame_id
    message.provenance = provenance_message(c.provenance)
    message.stages = [stage_message(stage) for stage in c.stages]
    message.starts = [to_time(drift.start) for drift in c.drifts]
    message.samples = [len(drift.times) for drift in c.drifts]
    message.q = [q for drift in c.drifts for q in drift.q]
    message.poses = [number for drift in c.drifts for pose in drift.poses for number in pose]
    for name in ("times", "frames", "seconds"):
        setattr(message, name, [value for drift in c.drifts for value in getattr(drift, name)])
    for name in (
        "verdict", "reason", "names", "units", "values", "covariance", "hose_torque",
        "hose_torque_deviation", "momenta", "momentum_deviations", "position_residual",
        "heading_residual", "chi_square", "degrees_of_freedom", "arm", "guess",
    ):  # fmt: skip
        setattr(message, name, plain(getattr(c, name)))
    return message


def observations_of(message: Any) -> list[Observation]:
    """The observations that a KinematicObservations message holds."""

    def value(one: Any, name: str) -> Any:
        given = getattr(one, name)
        if name in ("start", "end"):
            return stamp_ns(given)
        if name in ("boots", "homings"):
            return tuple(map(int, given))
        return tuple(map(float, given)) if name in ("q", "tip", "scatter") else given

    names = [f.name for f in fields(Observation)]
    return [Observation(**{n: value(one, n) for n in names}) for one in message.observations]


def plain(value: Any) -> Any:
    """An array or a tuple as the list that a message takes."""
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    return list(value) if isinstance(value, tuple) else value
