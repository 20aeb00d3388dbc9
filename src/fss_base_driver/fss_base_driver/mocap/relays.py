"""Messages of the receivers that laboratories run, as poses in metres by subject."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from fss_base_driver.mocap.subjects import Pose

MILLIMETRE = 1e-3


class RelayError(ValueError):
    """A topic's messages cannot be read; the message says why."""


@dataclass
class Relay:
    """A topic to pass on."""

    subject: str  # whose poses they are; empty: the messages say it, or else the topic's last name
    topic: str
    lacks: str = "nobody publishes it"  # why it is not passed on yet, in words; empty: it is

    @property
    def last_name(self) -> str:
        """Of the topic."""
        return self.topic.rpartition("/")[2]


def message_type(names: Iterable[str]) -> Any:
    """The class of the first of a topic's types, as geometry_msgs/msg/PoseStamped, that is one.

    Raises:
        RelayError: none of them tells a pose that we know of, or its package is not there.
    """
    known = [name for name in names if name.rpartition("/")[2] in READERS]
    if not known:
        have = ", ".join(names)
        raise RelayError(f"{have} is no type of poses; there are {', '.join(READERS)}")
    package, _, kind = known[0].partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise RelayError(f"{known[0]} is published, but its package is not installed") from None


def named_poses(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    """The poses in a message, by subject.

    Args:
        message: of one of READERS.
        subject: whose pose it is; empty: the message's own name for it, if it has one.
        scale: of its lengths [m]; vicon_receiver's Position has millimetres in any case.
    """
    return READERS[type(message).__name__](message, subject, scale)


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
    """Of OPT4SMART's ros2-vicon-receiver: lengths in millimetres."""
    m, mm = message, MILLIMETRE
    pose = m.x_trans * mm, m.y_trans * mm, m.z_trans * mm, m.x_rot, m.y_rot, m.z_rot, m.w
    yield subject or m.subject_name, pose


def _pose(at: Any, turn: Any, scale: float) -> Pose:
    return at.x * scale, at.y * scale, at.z * scale, turn.x, turn.y, turn.z, turn.w


READERS = {
    "PoseStamped": _pose_stamped,
    "TransformStamped": _transform_stamped,
    "NamedPoseArray": _named_pose_array,
    "Position": _position,
}
