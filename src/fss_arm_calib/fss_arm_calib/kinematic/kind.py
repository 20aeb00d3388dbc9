"""Kinematic calibration as a calibration kind: topics, messages and record."""

from collections.abc import Sequence

from fss_arm_calib.calibration import Calibration, Data, Input
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.measurements import measurements
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import Solution
from fss_arm_calib.messages import (
    common_message,
    flatten,
    joints_input,
    poses_input,
    set_header,
    telemetry_inputs,
)
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_calib.segments.rests import Observation, RestFinder
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import rehomed_joints
from fss_arm_model.description import Arm
from fss_arm_msgs.msg import (
    KinematicCalibration,
    KinematicObservation,
    KinematicObservations,
)
from fss_arm_ros.convert import stamp_ns, to_time


def inputs(s: KinematicSettings, n: int) -> list[Input]:
    """Return the inputs: joints, base, end effector, and the links' homing reports."""
    return [
        *telemetry_inputs(n),
        joints_input(s.joints_topic),
        poses_input(s.base_topic, BASE),
        poses_input(s.tip_topic, TIP),
    ]


def finder(arm: Arm, s: KinematicSettings, kept: Sequence[Observation]) -> RestFinder:
    """Return a rest finder that skips the rest already observed before the node started."""
    return RestFinder(arm.n, s, kept[-1].q if kept and kept[-1].used else None)


def to_message(outcome: Outcome[Observation, Solution], frame_id: str) -> KinematicCalibration:
    """Convert the outcome to the message that is published."""
    message, last = KinematicCalibration(), outcome.used[-1:]
    message.calibration = common_message("kinematic", outcome, frame_id)
    for one in last:
        message.boots, message.homings = list(one.boots), list(one.homings)
    if found := outcome.solution:
        message.held_out = flatten(found.held_out)
        message.held_out_residuals = flatten(found.prediction.residuals)
        message.held_out_normalized = flatten(found.prediction.normalized)
    return message


def observations_message(
    observations: Sequence[Observation], frame_id: str
) -> KinematicObservations:
    """Convert all observations to the message that is published."""
    message = KinematicObservations(subject=TIP)
    ones = [
        KinematicObservation(
            start=to_time(o.start),
            end=to_time(o.end),
            q=list(o.q),
            tip=list(o.tip),
            scatter=list(o.scatter),
            joint_samples=o.joint_samples,
            vicon_frames=o.vicon_frames,
            used=o.used,
            reason=o.reason,
            time_offset=o.time_offset,
            boots=list(o.boots),
            homings=list(o.homings),
        )
        for o in observations
    ]
    message.observations = ones
    return set_header(message, ones, frame_id)


def observations_of(message: KinematicObservations) -> list[Observation]:
    """Return the observations in a message."""
    return [
        Observation(
            start=stamp_ns(one.start),
            end=stamp_ns(one.end),
            q=tuple(map(float, one.q)),
            tip=tuple(map(float, one.tip)),
            scatter=tuple(map(float, one.scatter)),
            joint_samples=int(one.joint_samples),
            vicon_frames=int(one.vicon_frames),
            time_offset=float(one.time_offset),
            boots=tuple(map(int, one.boots)),
            homings=tuple(map(int, one.homings)),
            used=bool(one.used),
            reason=one.reason,
        )
        for one in message.observations
    ]


def stale(outcome: Outcome[Observation, Solution], streams: Streams) -> str:
    """Return a message if a joint was homed or restarted since, else an empty string."""
    again = rehomed_joints(outcome.used[-1], streams) if outcome.used else []
    names = ", ".join(f"joint_{i}" for i in again)
    return f"{names} homed or restarted since: calibrate the offsets" if again else ""


KINEMATIC = Calibration(
    name="kinematic",
    about=KinematicSettings.ABOUT,
    settings=KinematicSettings,
    data=Data(
        "observation", Observation, "calibration/observations", observations_message,
        observations_of, lambda one: f"averaged {one.vicon_frames} frames",
    ),
    max_data=lambda s: s.max_observations,
    inputs=inputs,
    finder=finder,
    calibrate=calibrate,
    measurements=measurements,
    message=KinematicCalibration,
    to_message=to_message,
    compared_fields=("held_out_residuals", "held_out_normalized"),
    report=kinematic_report,
    stale=stale,
)  # fmt: skip
