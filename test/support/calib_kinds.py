"""Data that make a calibration of each kind pass, and what publishes and hears them."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import calib_drives
import numpy as np
from calib_float import Float, postures
from calib_rig import ARM, message, resting
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_srvs.srv import Trigger

from fss_arm_bags.definitions import definition
from fss_arm_bags.recorder import Recording
from fss_arm_calib.calibration_node import CalibrationNode
from fss_arm_ros.qos import LATCHED, sensor

TRUTH = replace(
    ARM,
    base=replace(ARM.base, inertia=0.24, com=(0.004, -0.006)),
    links=(replace(ARM.links[0], b=0.185), *ARM.links[1:3], replace(ARM.links[3], inertia=0.03)),
)
STATE = np.array([0.1, 0.2, 3.0, 0.1, -0.1, 0.02, 0.0002, -0.0001])
DRIFTING = np.array([0.1, -0.2, 0.4, 0.02, -0.01, 0.01, 2e-4, -1e-4])
PRECISE = {"position_deviation": 0.0005, "heading_deviation": 0.001}
#: Settings of nodes, by kind, of what is seen that closely.
CLOSELY = {
    "kinematic": {"position_deviation": 0.001, "heading_deviation": 0.002},
    "dynamic": PRECISE,
    "drift": {"min_duration": 3.0, "bin": 0.2, **PRECISE},
}


@dataclass(frozen=True)
class Case:
    """A kind of calibration, and samples that make it pass."""

    kind: str
    samples: Callable[[], list[Any]]
    settings: dict[str, Any]
    count: int  # data in the samples
    most: str  # the setting of how many data a result is from
    streams: str = "joint"  # whose numbers streams have that are heard of each joint


def drifting() -> list[Any]:
    flight = Float(postures(2), state=DRIFTING, rest=40.0, noise=(0.001, 0.009))
    return [s for s in flight.samples(rate=20) if s.stream != "gyro"]


def turning() -> list[Any]:
    moves = calib_drives.excitation(4, np.random.default_rng(0))
    return calib_drives.samples(calib_drives.fly(ARM, moves[: len(moves) // 2], seed=0).telemetry)


def maneuvering(tip: bool = False, noise: tuple[float, float] = (0.0, 0.0)) -> list[Any]:
    """Ten maneuvers between rests."""
    return Float(postures(10, seed=3), TRUTH.vector(), STATE, noise=noise).samples(20, tip)


CASES = {
    case.kind: case
    for case in (
        Case("kinematic", resting, {}, 8, "max_observations"),
        Case("dynamic", maneuvering, PRECISE, 10, "max_maneuvers"),
        Case("drives", turning, {"max_relative": 0.3}, 53, "max_excitations", "link"),
        Case("drift", drifting, {}, 3, "max_drifts"),
    )
}


def make_node(kind, **settings):
    overrides = [Parameter(k, value=v) for k, v in settings.items()]
    return CalibrationNode(kind, parameter_overrides=overrides)


class Bed(Node):
    """Publishes samples, and hears what a calibration says."""

    def __init__(self, kind, n=4):
        super().__init__("bed")
        self.kind = kind
        self.outputs = {
            one.topic: self.create_publisher(
                one.message, one.topic, LATCHED if one.latched else sensor(keep_all=True)
            )
            for one in kind.inputs(kind.settings(), n)
        }
        self.data, self.results = [], []
        self.create_subscription(kind.data.message, kind.data.topic, self.data.append, LATCHED)
        self.create_subscription(kind.message, kind.topic, self.results.append, LATCHED)
        self.solver = self.create_client(Trigger, f"{kind.name}/solve")
        self.forgetter = self.create_client(Trigger, f"{kind.name}/forget")

    def ready(self):
        return self.solver.service_is_ready() and all(
            p.get_subscription_count() for p in self.outputs.values()
        )

    def found(self):
        """Number of data in the last message heard; -1: none was."""
        return len(self.kind.data.from_message(self.data[-1])) if self.data else -1


def play(spin, bed, node, samples):
    """Publish samples as fast as the node hears them."""
    spin([bed, node], bed.ready)
    heard, on_sample = [], node.on_sample
    node.add_data, add_data = lambda found: heard.append(1) or add_data(found), node.add_data
    for k, sample in enumerate(samples, 1):
        topic, content = message(sample)
        bed.outputs[topic].publish(content)
        if k % 100 == 0:
            spin([bed, node], lambda n=k: len(heard) >= n - 100, 30.0)
    spin([bed, node], lambda: len(heard) >= len(samples), 60.0)
    node.add_data = add_data
    assert node.on_sample == on_sample


def ask(spin, bed, node, client):
    answer = client.call_async(Trigger.Request())
    return spin([bed, node], lambda: answer.done() and answer.result(), 120.0)


@cache
def types(kind):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(kind).text, kind))
    return store


def recorded(folder, kind, *pairs):
    """A bag of results, each after the data that it is from; one of both may be None."""
    bag, topics = Recording(folder), (kind.data.topic, kind.topic)
    for k, pair in enumerate(pairs):
        for topic, one in zip(topics, pair, strict=True):
            if one:
                if f"/{topic}" not in bag.topics:
                    bag.add(f"/{topic}", f"fss_arm_msgs/msg/{type(one).__name__}", [LATCHED])
                bag.write(f"/{topic}", 10 * k + 1, serialized(one))
    bag.close()
    return str(bag.path)


def serialized(message):
    """As a publisher does it: serialize_message may leave some bytes more at the end."""
    kind, data = f"fss_arm_msgs/msg/{type(message).__name__}", serialize_message(message)
    for end in range(len(data), len(data) - 100, -1):
        with suppress(SerdeError):
            types(kind).deserialize_cdr(data[:end], kind)
            return data[:end]
    raise AssertionError(kind)
