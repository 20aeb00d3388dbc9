"""Inputs of finders from ROS messages, and the message that all results share.

Messages are read by attribute, so that those of rclpy and of rosbags both work.
"""

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Imu, JointState

from fss_arm_bags.bulk import frame_id, poses, turn_rates
from fss_arm_calib.calibration import Input
from fss_arm_calib.codec import encode
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.poses import BASE
from fss_arm_model.description_file import to_yaml
from fss_arm_msgs.msg import Calibration, Check, LinkTelemetry, Provenance
from fss_arm_ros.convert import joint_readings, seen_pose, stamp_ns, to_time

AnyFinder = Finder[Any, Any]

MAX_LISTED_NAMES = 20  # most unknown joint names that are reported of a message

#: Fields of Calibration.msg that are computed from the data alone.
COMPUTED_FIELDS = ["values", "deviations", "covariance", "residuals", "weights", "leverage"]
COMPUTED_FIELDS += ["errors", "position_residual", "heading_residual", "chi_square"]
COMPUTED_FIELDS += ["condition_number"]


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

    return Input(topic, JointState, feed, option="--joints-topic")


def poses_input(topic: str, subject: str, needed: bool = True) -> Input:
    """Return the input of a subject's planar poses, PoseStamped; a bag must have it if `needed`."""

    def feed(finder: AnyFinder, message: Any) -> list[Any]:
        finder.sensors.subjects[subject].frame = str(message.header.frame_id)
        return finder.add_pose(subject, stamp_ns(message.header.stamp), seen_pose(message))

    def feed_many(finder: AnyFinder, data: Sequence[bytes]) -> list[Any]:
        if data:
            finder.sensors.subjects[subject].frame = frame_id(data[0])
        return finder.add_poses(subject, *poses(data))

    option = "--base-topic" if subject == BASE else "--tip-topic"
    return Input(topic, PoseStamped, feed, feed_many, needed, subject, option)


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
    streams = outcome.streams
    message = encode(outcome.estimate, Calibration)
    message.header.stamp, message.header.frame_id = to_time(outcome.provenance.end), frame_id
    message.undetermined += outcome.estimate.unmeasured
    message.kind, message.verdict, message.reason = kind, outcome.verdict, outcome.reason
    message.checks = [encode(check, Check) for check in outcome.checks]
    message.provenance = encode(outcome.provenance, Provenance)
    message.used, message.left_out = outcome.accepted, outcome.left_out
    message.rejected_kinds = list(streams.rejected)
    message.rejected = list(streams.rejected.values())
    message.time_offset = streams.offset.value
    message.time_offset_deviation = streams.offset.deviation
    message.arm, message.guess = outcome.arm.name, to_yaml(outcome.arm)
    message.description = outcome.description
    return message


def calibration_part(message: Any) -> Any:
    """Return the Calibration in a message of any kind; some kinds publish only a Calibration."""
    return getattr(message, "calibration", message)
