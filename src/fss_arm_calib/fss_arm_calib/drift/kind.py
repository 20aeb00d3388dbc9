"""Drift calibration as a calibration kind: topics, messages and record."""

from math import nan

from fss_arm_calib.calibration import Calibration, Input
from fss_arm_calib.codec import fieldwise_data, flatten
from fss_arm_calib.drift.calibrate import Solution, calibrate, measurements_of, parameters
from fss_arm_calib.drift.report import drift_report
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.messages import common_message, joints_input, poses_input
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.drifts import Drift, DriftFinder
from fss_arm_calib.segments.poses import BASE
from fss_arm_model.estimation.outliers import expand
from fss_arm_msgs import msg
from fss_arm_ros.convert import SECOND


def inputs(s: DriftSettings, _: int) -> list[Input]:
    """Return the inputs: joints and base."""
    return [joints_input(s.joints_topic), poses_input(s.base_topic, BASE)]


def to_message(outcome: Outcome[Drift, Solution], frame_id: str) -> msg.DriftCalibration:
    """Convert the outcome to the message that is published."""
    message = msg.DriftCalibration(hose_torque=nan, hose_torque_deviation=nan)
    message.calibration = common_message("drift", outcome, frame_id)
    if found := outcome.solution:
        message.hose_torque, message.hose_torque_deviation = found.result.hose_torque
        values, deviations = found.result.momenta
        message.momenta = flatten(expand(values, found.kept))
        message.momentum_deviations = flatten(expand(deviations, found.kept))
    return message


def rest_status(finder: DriftFinder) -> dict[str, object]:
    """Report the time for which the arm has been at rest."""
    begin, end = finder.current_rest
    return {"arm at rest for [s]": (end - begin) / SECOND}


DRIFT = Calibration(
    name="drift",
    settings=DriftSettings,
    data=fieldwise_data(
        "drift",
        Drift,
        "calibration/drifts",
        msg.Drifts,
        lambda one: f"of {one.times[-1]:.0f} s",
        pose_times="times",
        needed=("q", "times", "poses", "seconds"),
    ),
    max_data=lambda s: s.max_drifts,
    inputs=inputs,
    finder=lambda arm, s, _: DriftFinder(arm.n, s),
    calibrate=calibrate,
    measurements=measurements_of,
    message=msg.DriftCalibration,
    to_message=to_message,
    recomputed_fields=("hose_torque", "hose_torque_deviation", "momenta", "momentum_deviations"),
    frame="world",
    report=drift_report,
    output=parameters,
    output_name="parameters of dynamic and base_reaction",
    has_urdf=False,
    health=rest_status,
    unavailable={
        "time offset": "the arm is at rest during a drift, so a clock offset has no effect"
    },
    prior_results={
        "calibration/kinematic": msg.KinematicCalibration,
        "calibration/dynamic": msg.DynamicCalibration,
    },
)
