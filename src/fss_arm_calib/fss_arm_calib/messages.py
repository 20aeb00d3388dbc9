"""Conversion between calibrations and ROS messages.

Messages are read by attribute, so that those of rclpy and of rosbags both work.
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Imu, JointState

from fss_arm_bags.bulk import frame_id, poses, turn_rates
from fss_arm_calib.calibration import Input
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.outcome import Provenance as Origin
from fss_arm_calib.segments.finder import Finder
from fss_arm_model.description_file import to_yaml
from fss_arm_msgs.msg import Calibration, Check, LinkTelemetry, Provenance
from fss_arm_ros.convert import joint_readings, seen_pose, stamp_ns, to_time

AnyFinder = Finder[Any, Any]
M = TypeVar("M", bound=Any)

MAX_LISTED_NAMES = 20  # most unknown joint names that are reported of a message

#: Fields of Calibration.msg that are computed from the data alone.
COMPUTED_FIELDS = (
    "values", "deviations", "covariance", "residuals", "weights", "leverage", "errors",
    "position_residual", "heading_residual", "chi_square", "condition_number",
)  # fmt: skip


def joints_input(topic: str) -> Input:
    """Return the input of joint readings and rates: sensor_msgs/JointState, names joint_<i>."""

    def feed(finder: AnyFinder, message: Any) -> list[Any]:
        t, readings = stamp_ns(message.header.stamp), list(joint_readings(message))
        if len(readings) < len(message.name):
            own = {f"joint_{i}" for i, *_ in readings}
            finder.sensors.rests.other_names.update(
                [name for name in message.name if name not in own][:MAX_LISTED_NAMES]
            )
        return [one for i, q, qd, _ in readings for one in finder.add_reading(i, t, q, qd)]

    return Input(topic, JointState, feed)


def poses_input(topic: str, subject: str, needed: bool = True) -> Input:
    """Return the input of a subject's planar poses: geometry_msgs/PoseStamped.

    If `needed`, a bag must have the topic.
    """

    def feed(finder: AnyFinder, message: Any) -> list[Any]:
        finder.sensors.subjects[subject].frame = str(message.header.frame_id)
        return finder.add_pose(subject, stamp_ns(message.header.stamp), seen_pose(message))

    def feed_many(finder: AnyFinder, data: Sequence[bytes]) -> list[Any]:
        if data:
            finder.sensors.subjects[subject].frame = frame_id(data[0])
        return finder.add_poses(subject, *poses(data))

    return Input(topic, PoseStamped, feed, feed_many, needed, subject)


def rates_input(topic: str) -> Input:
    """Return the input of the base's turn rates: sensor_msgs/Imu, optional."""

    def feed(finder: AnyFinder, message: Any) -> list[Any]:
        return finder.add_rate(stamp_ns(message.header.stamp), float(message.angular_velocity.z))

    def feed_many(finder: AnyFinder, data: Sequence[bytes]) -> list[Any]:
        return finder.add_rates(*turn_rates(data))

    return Input(topic, Imu, feed, feed_many, needed=False)


def telemetry_inputs(n: int) -> list[Input]:
    """Return the inputs of the armed state and homings of n links: LinkTelemetry, optional."""

    def feed(finder: AnyFinder, message: Any) -> list[Any]:
        t, armed = stamp_ns(message.header.stamp), bool(message.armed)
        link, boot, homings = int(message.link), int(message.boot), int(message.homings)
        return finder.add_telemetry(link, t, armed, boot, homings)

    topics = (f"link_{i}/telemetry" for i in range(1, n + 1))
    return [Input(topic, LinkTelemetry, feed, needed=False) for topic in topics]


def common_message(kind: str, outcome: Outcome[Any, Any], frame_id: str) -> Calibration:
    """Return the message with the part of an outcome that all kinds of calibration share."""
    e, streams = outcome.estimate, outcome.streams
    message = Calibration(
        kind=kind,
        verdict=outcome.verdict,
        reason=outcome.reason,
        checks=[
            Check(
                name=check.name,
                verdict=check.verdict,
                value=float(check.value),
                threshold=float(check.threshold),
                reason=check.reason,
            )
            for check in outcome.checks
        ],
        provenance=provenance_message(outcome.provenance),
        names=list(e.names),
        units=list(e.units),
        values=flatten(e.values),
        initial=flatten(e.initial),
        deviations=flatten(e.deviations),
        covariance=flatten(e.covariance),
        undetermined=list(e.undetermined),
        residuals=flatten(e.residuals),
        weights=flatten(e.weights),
        leverage=flatten(e.leverage),
        errors=flatten(e.errors),
        reasons=list(e.reasons),
        position_residual=e.position_residual,
        heading_residual=e.heading_residual,
        chi_square=e.chi_square,
        degrees_of_freedom=e.degrees_of_freedom,
        condition_number=e.condition_number,
        iterations=e.iterations,
        last_update=e.last_update,
        used=outcome.accepted,
        left_out=outcome.left_out,
        rejected_kinds=list(streams.rejected),
        rejected=list(streams.rejected.values()),
        time_offset=streams.offset.value,
        time_offset_deviation=streams.offset.deviation,
        arm=outcome.arm.name,
        guess=to_yaml(outcome.arm),
        description=outcome.description,
    )
    message.header.stamp = to_time(outcome.provenance.end)
    message.header.frame_id = frame_id
    return message


def provenance_message(origin: Origin) -> Provenance:
    """Return the message with the provenance of a result."""
    known = {f.name: getattr(origin, f.name) for f in fields(origin)}
    return Provenance(**{k: to_time(v) if k in ("begin", "end") else v for k, v in known.items()})


def calibration_part(message: Any) -> Any:
    """Return the Calibration in a message of any kind; some kinds publish only a Calibration."""
    return getattr(message, "calibration", message)


def set_header(message: M, ones: Sequence[Any], frame_id: str) -> M:
    """Return the message of the data `ones` with its header; the stamp is the last one's end."""
    message.header.frame_id = frame_id
    message.header.stamp = ones[-1].end if ones else to_time(0)
    return message


def flatten(values: Any) -> list[Any]:
    """Convert an array, or a tuple that may contain tuples, to a flat list for a message."""
    if isinstance(values, np.ndarray):
        return list(values.ravel().tolist())
    return [
        x for value in values for x in (flatten(value) if isinstance(value, tuple) else [value])
    ]


def reshape_rows(numbers: Any, width: int) -> tuple[tuple[float, ...], ...]:
    """Convert the numbers of a message to rows of a width."""
    return tuple(map(tuple, np.reshape(numbers, (-1, width)).astype(float).tolist()))
