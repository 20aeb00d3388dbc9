"""Decode many serialized messages of one type into arrays: hours of motion capture in seconds.

A message is plain CDR behind four bytes that give its byte order. Numbers are aligned to their
size; a string is its length and its bytes with a final zero. All poses of a topic have the same
layout unless the frame id changes, so they can be decoded together.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.planar import project_to_plane
from fss_arm_ros.convert import SECOND, TURN_RATE

LITTLE_ENDIAN = b"\1"  # second byte of a message whose numbers have the low byte first


class SerializedError(ValueError):
    """A message is not of the type that it should be."""


class Poses(NamedTuple):
    """Planar poses of k messages."""

    stamp: Stamps  # (k,) [ns]
    pose: Floats  # (k, 3) x [m], y [m], heading [rad]; NaN: occluded


def poses(messages: Sequence[bytes]) -> Poses:
    """Return the planar poses in serialized geometry_msgs/PoseStamped, as `planar_pose` does.

    Raises:
        SerializedError: a message is something else.
    """
    stamp, numbers = spatial_poses(messages)
    return Poses(stamp, project_to_plane(numbers))


def spatial_poses(messages: Sequence[bytes]) -> tuple[Stamps, Floats]:
    """Return stamps [ns], positions [m] and quaternions x, y, z, w in geometry_msgs/PoseStamped.

    Returns:
        (k,) and (k, 7), also where the subject was occluded.

    Raises:
        SerializedError: a message is something else.
    """
    return _decode(messages, 7, "geometry_msgs/PoseStamped")


def frame_id(message: bytes) -> str:
    """Return the frame id of a serialized message that starts with a header."""
    size = int.from_bytes(message[12:16], "little" if message[1:2] == LITTLE_ENDIAN else "big")
    return message[16 : 16 + size].rstrip(b"\0").decode(errors="replace")


def turn_rates(messages: Sequence[bytes]) -> tuple[Stamps, Floats]:
    """Return stamps [ns] and turn rates about z [rad/s] in serialized sensor_msgs/Imu, (k,) each.

    Raises:
        SerializedError: a message is something else.
    """
    stamp, numbers = _decode(messages, 37, "sensor_msgs/Imu")
    return stamp, numbers[:, TURN_RATE]


def _decode(messages: Sequence[bytes], count: int, kind: str) -> tuple[Stamps, Floats]:
    """Return the stamps and the numbers that follow the header, (k,) and (k, count)."""
    groups = groupby(messages, key=_layout)
    parts = [_decode_group(list(group), count, kind) for _, group in groups]
    empty = np.empty(0, np.int64), np.empty((0, count))
    stamps, numbers = zip(empty, *parts, strict=True)
    return np.concatenate(stamps), np.concatenate(numbers)


def _layout(message: bytes) -> bytes:
    """Return a key of the message's layout: its length, byte order and frame id length."""
    return b"%d" % len(message) + message[1:2] + message[12:16]


def _decode_group(messages: list[bytes], count: int, kind: str) -> tuple[Stamps, Floats]:
    size = len(messages[0])
    little = messages[0][1:2] == LITTLE_ENDIAN
    id_length = int.from_bytes(messages[0][12:16], "little" if little else "big")
    offset = -(-(12 + id_length) // 8) * 8  # of the numbers
    if size < 4 + offset + 8 * count:
        raise SerializedError(f"a message of {size} bytes is not a {kind}")
    rows = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(-1, size)[:, 4:]

    def column(start: int, end: int, code: str) -> npt.NDArray[np.generic]:
        return np.ascontiguousarray(rows[:, start:end]).view(f"{'<' if little else '>'}{code}")

    time = column(0, 8, "u4").astype(np.int64)  # the seconds and the nanoseconds are positive
    numbers = column(offset, offset + 8 * count, "f8").astype(np.float64)
    return time[:, 0] * SECOND + time[:, 1], numbers


def batches(
    messages: Iterable[tuple[str, str, int, bytes]], span: int
) -> Iterator[dict[str, list[bytes]]]:
    """Group messages of `Bags.raw` by topic and yield `span` [ns] of receipt times at once."""
    batch: dict[str, list[bytes]] = {}
    until = -1
    for topic, _, receipt, data in messages:
        if receipt > until:
            if batch:
                yield batch
            batch, until = {}, receipt + span
        batch.setdefault(topic, []).append(data)
    if batch:
        yield batch
