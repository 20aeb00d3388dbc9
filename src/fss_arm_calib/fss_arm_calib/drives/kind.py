"""Calibration of drives as a calibration kind: topics, messages and record."""

from collections.abc import Sequence
from typing import Any

from fss_arm_calib.calibration import CAUSES, Calibration, Data, Input
from fss_arm_calib.drives.calibrate import calibrate
from fss_arm_calib.drives.problem import Drive
from fss_arm_calib.drives.report import drives_report
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.messages import common_message, set_header
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.excitations import Excitation, ExcitationFinder, Frame, Frames
from fss_arm_msgs import msg
from fss_arm_ros.convert import SECOND, stamp_ns, to_time

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


def excitations_message(excitations: Sequence[Excitation], frame_id: str) -> msg.Excitations:
    """Convert all excitations to the message that is published."""
    ones = [
        msg.Excitation(
            start=to_time(one.start),
            end=to_time(one.end),
            links=[_frames_message(link) for link in one.links],
            used=one.used,
            reason=one.reason,
        )
        for one in excitations
    ]
    return set_header(msg.Excitations(excitations=ones), ones, frame_id)


def _frames_message(frames: Frames) -> msg.LinkFrames:
    numbers = {name: [int(x) for x in getattr(frames, name)] for name in COLUMNS}
    return msg.LinkFrames(
        boot=frames.boot, homings=frames.homings, stamps=list(frames.stamps), **numbers
    )


def excitations_of(message: msg.Excitations) -> list[Excitation]:
    """Return the excitations in a message."""
    return [
        Excitation(
            start=stamp_ns(one.start),
            end=stamp_ns(one.end),
            links=tuple(map(_frames_of, one.links)),
            used=bool(one.used),
            reason=one.reason,
        )
        for one in message.excitations
    ]


def _frames_of(message: msg.LinkFrames) -> Frames:
    numbers = {name: tuple(map(float, getattr(message, name))) for name in COLUMNS}
    stamps = tuple(map(int, message.stamps))
    return Frames(boot=int(message.boot), homings=int(message.homings), stamps=stamps, **numbers)


def _summary(one: Excitation) -> str:
    return f"{(one.end - one.start) / SECOND:.1f} s"


DRIVES = Calibration(
    name="drives",
    about=DrivesSettings.ABOUT,
    settings=DrivesSettings,
    data=Data(
        "excitation", Excitation, "calibration/excitations", excitations_message, excitations_of,
        _summary,
    ),
    max_data=lambda s: s.max_excitations,
    inputs=inputs,
    finder=ExcitationFinder,
    calibrate=calibrate,
    message=msg.DrivesCalibration,
    to_message=to_message,
    compared_fields=("moving", "torque_residuals", "current_residuals"),
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
)  # fmt: skip
