"""Decoding many poses at once gives the same as one by one."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu

from fss_arm_bags.bulk import SerializedError, batches, poses, turn_rates
from fss_arm_ros.convert import SECOND, PoseError, planar_pose, stamp_ns, to_time

FRAMES = "", "w", "map", "world", "vicon/world"


def serialized(seed: int, count: int = 400) -> list[bytes]:
    """Poses of several frames, some occluded, some not finite."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        message = PoseStamped()
        message.header.stamp = to_time(1_700_000_000 * SECOND + k * 10_000_001)
        message.header.frame_id = FRAMES[(k // 50) % len(FRAMES)]
        p, o = message.pose.position, message.pose.orientation
        p.x, p.y, p.z, o.x, o.y, o.z, o.w = rng.normal(size=7).tolist()
        if k % 31 == 0:
            o.x = o.y = o.z = o.w = 0.0
        if k % 37 == 0:
            p.z = float("nan")
        found.append(serialize_message(message))
    return found


def one_by_one(messages: list[bytes]) -> tuple[list[int], list[tuple[float, ...]]]:
    stamps, decoded = [], []
    for data in messages:
        message = deserialize_message(data, PoseStamped)
        stamps.append(stamp_ns(message.header.stamp))
        try:
            decoded.append(planar_pose(message.pose))
        except PoseError:
            decoded.append((np.nan,) * 3)
    return stamps, decoded


def swap_bytes(data: bytes) -> bytes:
    """The same message with the high byte first (frame id of five letters)."""
    head = struct.unpack_from("<iII", data, 4)
    numbers = struct.unpack_from("<7d", data, 28)
    return b"\0\0\0\0" + struct.pack(">iII", *head) + data[16:28] + struct.pack(">7d", *numbers)


def test_batch_decoding_equals_single_decoding_bit_for_bit():
    messages = serialized(0)
    found = poses(messages)
    stamps, decoded = one_by_one(messages)
    assert found.stamp.tolist() == stamps
    np.testing.assert_array_equal(found.pose, decoded)


def test_both_byte_orders_are_read():
    messages = [m for m in serialized(3) if b"world\0" in m[:24] and b"vicon" not in m]
    assert len(messages) == 50
    mixed = [swap_bytes(m) if k % 3 == 0 else m for k, m in enumerate(messages)]
    np.testing.assert_array_equal(poses(mixed).pose, poses(messages).pose)
    assert np.array_equal(poses(mixed).stamp, poses(messages).stamp)


def test_no_messages_give_empty_arrays():
    assert poses([]).stamp.shape == (0,)
    assert poses([]).pose.shape == (0, 3)


@pytest.mark.parametrize("size", [0, 1, 4, 12, 15, 16, 28, 70])
def test_other_messages_are_rejected(size):
    (message,) = serialized(4, 1)
    with pytest.raises(
        SerializedError, match=f"a message of {size} bytes is not a geometry_msgs/PoseStamped"
    ):
        poses([message[:size]])


def test_batches_keep_the_order_within_a_topic():
    raw = [("ab"[k % 3 == 0], "type", 10 * k, bytes([k])) for k in range(20)]
    found = list(batches(raw, 55))
    assert len(found) == 4
    for topic in "ab":
        got = b"".join(data for piece in found for data in piece.get(topic, ()))
        assert got == b"".join(data for name, _, _, data in raw if name == topic)
    assert list(batches([], 55)) == []


def test_turn_rates_equal_single_decoding():
    rng, messages = np.random.default_rng(7), []
    for k in range(50):
        message = Imu()
        message.header.stamp = to_time(1_700_000_000 * SECOND + k)
        message.header.frame_id = FRAMES[(k // 20) % len(FRAMES)]
        message.orientation_covariance[0] = -1.0
        message.angular_velocity.z = float(rng.normal())
        message.linear_acceleration.x = float(rng.normal())
        messages.append(serialize_message(message))
    stamps, rates = turn_rates(messages)
    each = [deserialize_message(data, Imu) for data in messages]
    assert stamps.tolist() == [stamp_ns(m.header.stamp) for m in each]
    assert rates.tolist() == [m.angular_velocity.z for m in each]
    assert len(turn_rates([])[0]) == 0
    with pytest.raises(SerializedError, match="not a sensor_msgs/Imu"):
        turn_rates(serialized(0, 1))
