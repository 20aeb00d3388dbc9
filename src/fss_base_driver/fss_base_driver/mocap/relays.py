"""Messages of the receivers that laboratories run, as poses in metres by subject."""

from collections.abc import Iterator
from importlib import import_module
from typing import Any

from fss_base_driver.mocap.subjects import Pose

MILLIMETRE = 1e-3


class RelayError(ValueError):
    """A topic's messages cannot be read; the message says why."""


def message_type(name: str) -> Any:
    """The class of a type such as geometry_msgs/msg/PoseStamped.

    Raises:
        RelayError: its package is not there, or its messages tell no pose that we know of.
    """
    package, _, kind = name.partition("/msg/")
    if kind not in READERS:
        raise RelayError(f"{name} is no type of poses; there are {', '.join(READERS)}")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise RelayError(f"{name} is published, but its package is not installed here") from None


def named_poses(message: Any, subject: str, scale: float) -> Iterator[tuple[str, Pose]]:
    """The poses in a message, by subject.

    Args:
        message: of one of READERS.
        subject: whose pose it is, where the message itself has no name for it.
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
