"""Calibration of drives as a calibration kind: topics, messages and record."""

from typing import Any

from fss_arm_calib.calibration import CAUSES, Calibration, Input
from fss_arm_calib.codec import fieldwise_data
from fss_arm_calib.drives.calibrate import calibrate
from fss_arm_calib.drives.problem import Drive
from fss_arm_calib.drives.report import drives_report
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.messages import common_message
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.excitations import Excitation, ExcitationFinder, Frame
from fss_arm_msgs import msg
from fss_arm_ros.convert import SECOND, stamp_ns

COLUMNS = ("position", "velocity", "current", "torque", "torque_age")


def inputs(_: DrivesSettings, n: int) -> list[Input]:
    """Return the inputs: the telemetry of n links."""
    return [_input(i) for i in range(1, n + 1)]


def _input(i: int) -> Input:
    def feed(finder: ExcitationFinder, message: Any) -> list[Excitation]:
        numbers = {name: float(getattr(message, name)) for name in COLUMNS}
        frame = Frame(boot=int(message.boot), homings=int(message.homings), **numbers)
        return finder.add_frame(i, stamp_ns(message.header.stamp), frame)

    return Input(f"link_{i}/telemetry", msg.LinkTelemetry, feed)


def to_message(outcome: Outcome[Excitation, list[Drive]], frame_id: str) -> msg.DrivesCalibration:
    """Convert the outcome to the message that is published."""
    found = outcome.solution or []
    return msg.DrivesCalibration(
        calibration=common_message("drives", outcome, frame_id),
        moving=[one.moving for one in found],
        torque_residuals=[one.residuals[0] for one in found],
        current_residuals=[one.residuals[1] for one in found],
    )


DRIVES = Calibration(
    name="drives",
    settings=DrivesSettings,
    data=fieldwise_data(
        "excitation",
        Excitation,
        "calibration/excitations",
        msg.Excitations,
        lambda one: f"{(one.end - one.start) / SECOND:.1f} s",
    ),
    max_data=lambda s: s.max_excitations,
    inputs=inputs,
    finder=ExcitationFinder,
    calibrate=calibrate,
    message=msg.DrivesCalibration,
    to_message=to_message,
    recomputed_fields=("moving", "torque_residuals", "current_residuals"),
    report=drives_report,
    unavailable={
        "time offset": "all data of a link have the same clock; no other stream is used",
        "weight or outlier": "deviations are computed by leaving out blocks of 4 s",
        "unknown joint": "each link of the arm has its own topic",
        CAUSES: "the usual mistakes concern motion capture and joint states, which are not used",
    },
    prior_results={
        "calibration/kinematic": msg.KinematicCalibration,
        "calibration/dynamic": msg.DynamicCalibration,
    },
)
