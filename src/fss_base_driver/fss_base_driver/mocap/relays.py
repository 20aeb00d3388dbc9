"""Conversion of the messages of common receivers to poses in metres by subject."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from fss_base_driver.mocap.subjects import Pose

MILLIMETRE = 1e-3


class RelayError(ValueError):
    """Error of a topic that cannot be relayed."""


@dataclass
class Relay:
    """A relayed topic."""

    subject: str  # of the poses; empty: as named in the messages, or else the topic's last part
    topic: str
    obstacle: str = "it has no publisher"  # why it is not relayed yet; empty: it is

    @property
    def last_name(self) -> str:
        """Last part of the topic's name."""
        return self.topic.rpartition("/")[2]


def describe_waiting(relays: Iterable[Relay]) -> list[str]:
    """Return the topics that cannot be relayed yet, with reasons."""
    return [f"{relay.topic}: {relay.obstacle}" for relay in relays if relay.obstacle]


def message_type(names: Sequence[str], subject: str) -> Any:
    """Return the class of the first of a topic's types that contains poses.

    Args:
        names: the types, such as geometry_msgs/msg/PoseStamped.
        subject: name of the subject; empty: the name in the messages.

    Raises:
        RelayError: no type is one of READERS, its package is not installed, or its messages
            contain several subjects and one is given.
    """
    known = [name for name in names if name in READERS]
    if not known:
        have = ", ".join(names)
        raise RelayError(f"{have} contains no poses, expected one of {', '.join(READERS)}")
    if subject and READERS[known[0]] is _named_pose_array:
        raise RelayError(f"{known[0]} names its subjects: write the topic without {subject}=")
    package, _, kind = known[0].partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise RelayError(f"{known[0]} is published, but its package is not installed") from None


def named_poses(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    """Yield the poses in a message, by subject.

    Args:
        message: message of a type in READERS.
        subject: name of the subject; empty: the name in the message, if there is one.
        scale: length of one unit [m]; vicon_receiver's Position is always in millimetres.
    """
    kind = type(message)
    package = kind.__module__.partition(".")[0]
    return READERS[f"{package}/msg/{kind.__name__}"](message, subject, scale)


def _pose_stamped(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    pose = message.pose
    yield subject, _pose(pose.position, pose.orientation, scale)


def _transform_stamped(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    transform = message.transform
    name = subject or message.child_frame_id
    yield name, _pose(transform.translation, transform.rotation, scale)


def _named_pose_array(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    for named in message.poses:
        yield named.name, _pose(named.pose.position, named.pose.orientation, scale)


def _position(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    """Yield the pose of OPT4SMART's ros2-vicon-receiver, with lengths in millimetres."""
    m, mm = message, MILLIMETRE
    pose = m.x_trans * mm, m.y_trans * mm, m.z_trans * mm, m.x_rot, m.y_rot, m.z_rot, m.w
    yield subject or m.subject_name, pose


def _pose(at: Any, turn: Any, scale: float) -> Pose:
    return at.x * scale, at.y * scale, at.z * scale, turn.x, turn.y, turn.z, turn.w


READERS = {
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/TransformStamped": _transform_stamped,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": _named_pose_array,
    "vicon_receiver/msg/Position": _position,
}
