"""Topics of a vehicle in bags, and the streams of its joints, subjects and gyro."""

from collections.abc import Mapping
from difflib import get_close_matches
from itertools import zip_longest
from math import nan

import numpy as np

from fss_arm_bags.bulk import spatial_poses, turn_rates
from fss_arm_bags.reader import BagError, Bags
from fss_arm_bags.recorded import Recorded, Track
from fss_arm_ros.convert import stamp_ns

JOINT_STATE, POSE, IMU = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/Imu",
)


def find_topic(
    bags: Bags,
    name: str,
    msgtype: str,
    namespace: str = "",
    needed: bool = True,
    option: str = "",
) -> str:
    """Return the full name of a topic in the bags: in the namespace unless it starts with `/`.

    Args:
        bags: bags to search.
        name: name of the topic.
        msgtype: type of its messages.
        namespace: namespace of the vehicle.
        needed: False if the topic may be missing.
        option: option of the command line that names the topic; empty: none.

    Raises:
        BagError: the topic is of another type, or it is needed and missing.
    """
    within = namespace.strip("/")
    topic = f"/{within}/{name}" if within and name[0] != "/" else f"/{name.lstrip('/')}"
    if topic in bags.topics and bags.topics[topic].msgtype != msgtype:
        raise BagError(f"{topic} is of type {bags.topics[topic].msgtype}, expected {msgtype}")
    if topic not in bags.topics and needed:
        where = ", ".join(map(str, bags.paths))
        hint = _namespace_hint(bags, name) or _name_hint(bags, topic, msgtype, option)
        damaged = "".join(f"; damaged: {bag}" for bag in bags.recovered)
        raise BagError(f"no {topic} in {where}{hint}{damaged}")
    return topic


def _name_hint(bags: Bags, topic: str, msgtype: str, option: str) -> str:
    """Suggest the topic of a type that the name of a missing topic may mean."""
    there = [name for name, found in bags.topics.items() if found.msgtype == msgtype]
    if near := get_close_matches(topic, there, n=1, cutoff=0.5 if option else 0.6):
        return f"; is it {near[0]}?{f' Then add {option} {near[0]}' * bool(option)}"
    return f", which has {', '.join(there) or 'no topic'} of type {msgtype}"


def _namespace_hint(bags: Bags, topic: str) -> str:
    """Suggest the namespaces in which the bags have a missing topic; empty if there are none."""
    last = f"/{topic.lstrip('/')}"
    spaces = [found.removesuffix(last)[1:] for found in bags.topics if found.endswith(last)]
    named = " or ".join(f"--namespace {space}" for space in spaces if space)
    return named and f"; see {named}"


def read_streams(bags: Bags, subjects: Mapping[str, str]) -> Recorded:
    """Return the streams of joints, subjects and gyro on some topics; others are ignored.

    `subjects` are the subjects of the topics with poses, empty for other topics.
    """
    types = {topic: bags.topics[topic].msgtype for topic in subjects if topic in bags.topics}
    wanted = {topic for topic, kind in types.items() if kind in (JOINT_STATE, POSE, IMU)}
    received: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in wanted}
    for topic, _, receipt, message in bags.raw(wanted):
        received[topic].append((receipt, message))
    joints: dict[str, list[tuple[int, int, float, float]]] = {}
    poses, rates = {}, {}
    for topic, rows in received.items():
        receipts = np.array([receipt for receipt, _ in rows], dtype=np.int64)
        messages = [message for _, message in rows]
        if types[topic] == JOINT_STATE:
            for receipt, message in rows:
                state = bags.deserialize(message, JOINT_STATE)
                readings = zip_longest(state.name, state.position, state.velocity, fillvalue=nan)
                for joint, q, qd in readings:
                    row = stamp_ns(state.header.stamp), receipt, float(q), float(qd)
                    joints.setdefault(str(joint), []).append(row)
        elif messages and types[topic] == POSE:
            stamps, numbers = spatial_poses(messages)
            poses[subjects[topic]] = Track(stamps, receipts, numbers)
        elif messages:
            stamps, turns = turn_rates(messages)
            rates["gyro"] = Track(stamps, receipts, turns[:, None])
    readings_of = {}
    for joint, samples in joints.items():
        t, heard, *values = zip(*samples, strict=True)
        stamps, receipts = np.array([t, heard], dtype=np.int64)
        readings_of[joint] = Track(stamps, receipts, np.column_stack(values))
    return Recorded(readings_of, poses, rates)
