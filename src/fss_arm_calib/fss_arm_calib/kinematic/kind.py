"""Kinematic calibration as a calibration kind: topics, messages and record."""

from collections.abc import Sequence

from fss_arm_calib.calibration import Calibration, Input
from fss_arm_calib.codec import fieldwise_data, flatten
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.early_cause import early_cause
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import Solution, problem_of
from fss_arm_calib.kinematic.solve import RestMeasurements
from fss_arm_calib.messages import common_message, joints_input, poses_input, telemetry_inputs
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_calib.segments.rests import Observation, RestFinder
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import keep_since_homing, rehomed_joints
from fss_arm_model.description import Arm
from fss_arm_msgs.msg import KinematicCalibration, KinematicObservations


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


def stale(outcome: Outcome[Observation, Solution], streams: Streams) -> str:
    """Return a message if a joint was homed or restarted since, else an empty string."""
    again = rehomed_joints(outcome.used[-1], streams) if outcome.used else []
    names = ", ".join(f"joint_{i}" for i in again)
    return f"{names} homed or restarted since: observe new rests" if again else ""


def likely_cause(observations: Sequence[Observation], arm: Arm, s: KinematicSettings) -> str:
    """Describe the likely cause of observations that contradict the description; else empty."""
    used = [one for one in keep_since_homing(observations) if one.used]
    return early_cause(problem_of(used, arm, s))


KINEMATIC = Calibration(
    name="kinematic",
    settings=KinematicSettings,
    data=fieldwise_data(
        "observation",
        Observation,
        "calibration/observations",
        KinematicObservations,
        lambda one: f"averaged {one.vicon_frames} poses",
        needed=("q", "tip"),
        subject=TIP,
    ),
    max_data=lambda s: s.max_observations,
    inputs=inputs,
    finder=finder,
    calibrate=calibrate,
    measurements=lambda rests, arm, s: RestMeasurements(problem_of(rests, arm, s)),
    message=KinematicCalibration,
    to_message=to_message,
    recomputed_fields=("held_out_residuals", "held_out_normalized"),
    report=kinematic_report,
    stale=stale,
    early_cause=likely_cause,
)
