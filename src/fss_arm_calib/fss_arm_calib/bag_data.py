"""Data that a finder obtains from bags, found as in a node, and the recorded streams themselves."""

from collections.abc import Sequence
from difflib import get_close_matches
from itertools import zip_longest
from math import nan
from typing import TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Imu, JointState

from fss_arm_bags.bulk import batches, spatial_poses, turn_rates
from fss_arm_bags.reader import BagError, Bags, digest
from fss_arm_calib.calibration import Finder, Input
from fss_arm_calib.segments.recorded import Recorded, Track
from fss_arm_calib.segments.streams import Datum
from fss_arm_ros.convert import SECOND, stamp_ns

D = TypeVar("D", bound=Datum)

CHUNK = 0.2  # part of a bag that is read at once, as a fraction of the horizon (largest stream lag)


def describe_source(bags: Bags) -> str:
    """Return the names of the bags, the SHA-256 of their data and the losses of damaged bags."""
    words = "({0.messages} messages recovered, {0.lost} bytes lost)"
    lost = {one.path: f" {words.format(one)}" for one in bags.recovered}
    return ", ".join(f"{path.name} {digest(path)}{lost.get(path, '')}" for path in bags.paths)


def find_data(
    bags: Bags, finder: Finder[D], inputs: Sequence[Input], horizon: float, namespace: str = ""
) -> list[D]:
    """Feed the messages of the bags to a finder and return the data that it finds."""
    topics = {topic_name(bags, one, namespace): one for one in inputs}
    found: list[D] = []
    for piece in batches(bags.raw(set(topics)), round(CHUNK * horizon * SECOND)):
        for topic, one in topics.items():
            data = piece.get(topic, [])
            if one.bulk:
                found += one.bulk(finder, data)
                continue
            for message in data:
                found += one.feed(finder, bags.deserialize(message, one.type))
    return found + finder.close()


def recorded_streams(bags: Bags, inputs: Sequence[Input], namespace: str = "") -> Recorded:
    """Return the recorded streams of joints, subjects and gyro, for another replay."""
    topics = {topic_name(bags, one, namespace): one for one in inputs}
    kinds = JointState, PoseStamped, Imu
    wanted = {topic for topic, one in topics.items() if one.message in kinds}
    received: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in wanted}
    for topic, _, receipt, message in bags.raw(wanted):
        received[topic].append((receipt, message))
    joints: dict[str, list[tuple[int, int, float, float]]] = {}
    poses, rates = {}, {}
    for topic, rows in received.items():
        one, receipts = topics[topic], np.array([receipt for receipt, _ in rows], dtype=np.int64)
        messages = [message for _, message in rows]
        if one.message is JointState:
            for receipt, message in rows:
                state = bags.deserialize(message, one.type)
                readings = zip_longest(state.name, state.position, state.velocity, fillvalue=nan)
                for joint, q, qd in readings:
                    row = stamp_ns(state.header.stamp), receipt, float(q), float(qd)
                    joints.setdefault(str(joint), []).append(row)
        elif one.message is PoseStamped and messages:
            stamps, numbers = spatial_poses(messages)
            poses[one.subject] = Track(stamps, receipts, numbers)
        elif messages:
            stamps, turns = turn_rates(messages)
            rates["gyro"] = Track(stamps, receipts, turns[:, None])
    readings_of = {}
    for joint, samples in joints.items():
        t, heard, *values = zip(*samples, strict=True)
        stamps, receipts = np.array([t, heard], dtype=np.int64)
        readings_of[joint] = Track(stamps, receipts, np.column_stack(values))
    return Recorded(readings_of, poses, rates)


def topic_name(bags: Bags, one: Input, namespace: str = "", needed: bool = True) -> str:
    """Return the topic name of an input in the bags: in the namespace unless it starts with `/`.

    Raises:
        BagError: the topic is of another type, or it is needed and missing.
    """
    within = namespace.strip("/")
    topic = (
        f"/{within}/{one.topic}" if within and one.topic[0] != "/" else f"/{one.topic.lstrip('/')}"
    )
    if topic in bags.topics and bags.topics[topic].msgtype != one.type:
        raise BagError(f"{topic} is of type {bags.topics[topic].msgtype}, expected {one.type}")
    if topic not in bags.topics and one.needed and needed:
        where = ", ".join(map(str, bags.paths))
        hint = namespace_hint(bags, one.topic) or _name_hint(bags, topic, one)
        damaged = "".join(f"; damaged: {bag}" for bag in bags.recovered)
        raise BagError(f"no {topic} in {where}{hint}{damaged}")
    return topic


def _name_hint(bags: Bags, topic: str, one: Input) -> str:
    """Suggest the topic of an input's type that the name of a missing topic may mean."""
    there = [name for name, found in bags.topics.items() if found.msgtype == one.type]
    if near := get_close_matches(topic, there, n=1, cutoff=0.5 if one.option else 0.6):
        return f"; is it {near[0]}?{f' Then add {one.option} {near[0]}' * bool(one.option)}"
    return f", which has {', '.join(there) or 'no topic'} of type {one.type}"


def namespace_hint(bags: Bags, topic: str) -> str:
    """Suggest the namespaces in which the bags have a missing topic; empty if there are none."""
    last = f"/{topic.lstrip('/')}"
    spaces = [found.removesuffix(last)[1:] for found in bags.topics if found.endswith(last)]
    named = " or ".join(f"--namespace {space}" for space in spaces if space)
    return named and f"; see {named}"
