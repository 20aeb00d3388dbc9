"""Data that make a calibration of each kind pass, and what publishes and hears them."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import calib_drives
import calib_float
import calib_rig
import numpy as np
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_srvs.srv import Trigger

from fss_arm_bags.definitions import definition
from fss_arm_bags.recorder import Recording
from fss_arm_calib.calibration_node import CalibrationNode
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_ros.qos import LATCHED, sensor

ARM = calib_rig.ARM
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
    "drift": {
        "min_duration": 3.0,
        "bin": 0.2,
        "position_deviation": 0.0005,
        "heading_deviation": 0.001,
    },
}


@dataclass(frozen=True)
class Case:
    """A kind of calibration, and samples that make it pass."""

    kind: str
    samples: Callable[[], list[Any]]
    module: Any  # whose `message` and `record` know the samples
    settings: dict[str, Any]
    count: int  # data in the samples
    most: str  # the setting of how many data a result is from
    streams: str = "joint"  # whose numbers streams have that are heard of each joint


def drifting() -> list[Any]:
    flight = calib_float.Float(
        calib_float.postures(2), state=DRIFTING, rest=40.0, noise=(0.001, 0.009)
    )
    return [s for s in flight.samples(rate=20) if s.stream != "gyro"]


def turning() -> list[Any]:
    moves = calib_drives.excitation(4, np.random.default_rng(0))
    return calib_drives.samples(calib_drives.fly(ARM, moves[: len(moves) // 2], seed=0).telemetry)


def resting() -> list[Any]:
    return calib_rig.Rig(DEFAULT_POSTURES[:8], rest=3.2, rate=25.0).samples()


def maneuvering() -> list[Any]:
    flight = calib_float.Float(calib_float.postures(10, seed=3), TRUTH.vector(), STATE)
    return flight.samples(rate=20)


CASES = {
    case.kind: case
    for case in (
        Case("kinematic", resting, calib_rig, {}, 8, "max_observations"),
        Case("dynamic", maneuvering, calib_float, PRECISE, 10, "max_maneuvers"),
        Case("drives", turning, calib_drives, {"max_relative": 0.3}, 53, "max_excitations", "link"),
        Case("drift", drifting, calib_float, {}, 3, "max_drifts"),
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


def play(spin, bed, node, samples, message):
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


def recorded(folder, kind, data, result):
    """A bag of a result and the data that it is from."""
    bag = Recording(folder)
    for stamp, topic, message in ((1, kind.data.topic, data), (2, kind.topic, result)):
        bag.add(f"/{topic}", f"fss_arm_msgs/msg/{type(message).__name__}", [LATCHED])
        bag.write(f"/{topic}", stamp, serialized(message))
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
