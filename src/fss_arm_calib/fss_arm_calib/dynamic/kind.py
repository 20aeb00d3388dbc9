"""Dynamic calibration as a calibration kind: topics, messages and record."""

from fss_arm_calib.acceptance import format_indices
from fss_arm_calib.calibration import Calibration, Input
from fss_arm_calib.codec import fieldwise_data, flatten
from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.dynamic.problem import ManeuverMeasurements
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution, problem_of
from fss_arm_calib.messages import (
    common_message,
    joints_input,
    poses_input,
    rates_input,
    telemetry_inputs,
)
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.maneuvers import Maneuver, ManeuverFinder
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_msgs import msg


def inputs(s: DynamicSettings, n: int) -> list[Input]:
    """Return the inputs: n joints and base; gyro, end effector and telemetry are optional."""
    return [
        *telemetry_inputs(n),
        joints_input(s.joints_topic),
        rates_input(s.gyro_topic),
        poses_input(s.tip_topic, TIP, needed=False),
        poses_input(s.base_topic, BASE),
    ]


def to_message(outcome: Outcome[Maneuver, Solution], frame_id: str) -> msg.DynamicCalibration:
    """Convert the outcome to the message that is published."""
    message, found = msg.DynamicCalibration(), outcome.solution
    message.calibration = common_message("dynamic", outcome, frame_id)
    if not found:
        return message
    r = found.result
    message.random_covariance = flatten(r.random)  # of observations and priors, (p, p)
    message.known = flatten(r.problem.prior_deviations)
    message.prior_share = flatten(r.prior_share)
    message.at_bound = list(r.at_bound)
    message.assumed = list(r.assumed_names)
    message.assumed_deviations = flatten(r.assumed_deviations)
    message.bias = flatten(r.bias)
    message.combinations = [c.name for c in found.combinations]
    message.combination_units = [c.unit for c in found.combinations]
    message.combination_values = [c.value for c in found.combinations]
    message.combination_before = [c.before for c in found.combinations]
    message.combination_deviations = [c.deviation for c in found.combinations]
    message.directions = [d.text(outcome.names) for d in found.directions]
    message.direction_kinds = [d.kind for d in found.directions]
    message.direction_gains = [d.gain for d in found.directions]
    message.momenta = flatten(found.momenta)
    return message


DYNAMIC = Calibration(
    name="dynamic",
    settings=DynamicSettings,
    data=fieldwise_data(
        "maneuver",
        Maneuver,
        "calibration/maneuvers",
        msg.Maneuvers,
        lambda one: f"used, {format_indices([i - 1 for i in one.moved_joints], 'joint')} moved",
        pose_times="marks",
        needed=("times", "q", "marks", "poses", "seconds"),
    ),
    max_data=lambda s: s.max_maneuvers,
    inputs=inputs,
    finder=lambda arm, s, _: ManeuverFinder(arm.n, s),
    calibrate=calibrate,
    measurements=lambda maneuvers, arm, s: ManeuverMeasurements(problem_of(maneuvers, arm, s)),
    message=msg.DynamicCalibration,
    to_message=to_message,
    recomputed_fields=("combination_values", "momenta"),
    report=dynamic_report,
    prior_results={"calibration/kinematic": msg.KinematicCalibration},
)
