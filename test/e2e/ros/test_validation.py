"""Every field of every message that a node hears, at its extremes: no node ends by it."""

from importlib import import_module
from time import monotonic

import numpy as np
import pytest
from all_nodes import NODES
from diagnostic_msgs.msg import DiagnosticArray
from message_fields import changed, element, fields
from rclpy.node import Node
from rclpy.qos import QoSProfile
from running import OWN, memory

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import to_yaml
from fss_arm_ros.qos import LATCHED
from fss_rehearsal.processes import Nodes

THEIRS = ("/parameter_events", "/clock", "/rosout")  # not the node's own to read
NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 0.0, 5e-324)
WORDS = ("", "joint_", "joint_" + 5000 * "9", "joint_0", "link_\u0664", 100_000 * "x")
MANY = 300_000
GROWTH = 40.0  # by what has come once before; workspace computes meanwhile [MB]
RESULTS = ("calibration/", "workspace/", "thrusters/health")  # which are latched


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    with Nodes(tmp_path_factory.mktemp("nodes"), print, OWN) as nodes:
        for name, (package, executable, given) in NODES.items():
            nodes.start(name, package, executable, **given)
        yield nodes


def plausible(kind):
    """A message as its publisher would send it, as far as types tell."""
    message = kind()
    name = kind.__name__
    if name == "JointState":
        message.name = [f"joint_{i}" for i in (1, 2, 3, 4)]
        message.position, message.velocity, message.effort = [0.1] * 4, [0.0] * 4, [0.0] * 4
    elif name == "PoseStamped":
        message.pose.orientation.w = 1.0
    elif name.endswith("Calibration"):
        found = message.calibration
        found.kind, found.verdict = name.removesuffix("Calibration").lower(), "pass"
        found.description = to_yaml(paper_arm())
        found.names = ["a_1", "a_2"]
        found.units, found.values, found.initial = ["m", "m"], [0.3, 0.3], [0.3, 0.3]
        found.deviations, found.covariance = [1e-3, 1e-3], [1e-6, 0.0, 0.0, 1e-6]
    return message


def extremes(message):
    """(path, value) for each field of a message, those of messages in it too."""
    for here, value, kind in fields(message):
        if kind.startswith("sequence<"):
            yield from ((here, one) for one in sequences(value, kind[9:-1]))
        elif "[" in kind:
            yield from ((here, [number] * len(value)) for number in numbers(kind.split("[")[0]))
        elif kind == "string":
            yield from ((here, word) for word in WORDS)
        else:
            yield from ((here, number) for number in numbers(kind))


def numbers(kind):
    """The extremes of a type of number."""
    if kind in ("double", "float"):
        return [x for x in NUMBERS if kind == "double" or not abs(x) > 3e38 or np.isinf(x)]
    if kind == "boolean":
        return [False, True]
    if not kind.startswith(("int", "uint")):
        return []
    limits = np.iinfo(kind)
    return [int(limits.min), int(limits.max), 0]


def sequences(value, kind):
    """Of a sequence: nothing, one too many, one too few, and extremes in one place."""
    value = list(value)
    yield []
    if "/" in kind:
        one = element(kind)
        yield [*value, one]
        for path, extreme in extremes(one):
            yield [changed(one, path, extreme)]
        return
    if kind == "string":
        yield from ([*value[:-1], word] for word in WORDS)
        yield [*value, "one too many"]
        yield ["many"] * 100_000
        return
    one = 1 if "int" in kind else 1.0
    yield [*value, one]
    yield value[:-1]
    yield from ([*value[:-1], number] for number in numbers(kind))
    yield [one] * MANY


class Stranger(Node):
    """Publishes anything, and hears who still lives."""

    def __init__(self, spin):
        super().__init__("stranger")
        self.spin, self.alive = spin, {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self.hear, 100)

    def hear(self, message):
        for status in message.status:
            name = status.name.lstrip("/")
            self.alive[name] = monotonic(), {v.key: v.value for v in status.values}

    def topics(self, name):
        """What a node listens to."""
        found = self.get_subscriber_names_and_types_by_node(name, "/")
        heard = [(topic, kinds[0]) for topic, kinds in found if topic not in THEIRS]
        return [one for one in heard if "/_action/" not in one[0]]  # an action client's

    def see(self, nodes, names, since, what):
        """Wait until all of these have said how they are, after a time, or one has ended."""

        def seen():
            for name in names:
                code = nodes.processes[name].poll()
                assert code is None, f"{what} ended {name}: {nodes.last_log_line(name)}"
            return all(self.alive.get(name, (0.0,))[0] > since for name in names)

        self.spin(self, seen, timeout=90.0)


@pytest.mark.slow
def test_no_message_ends_a_node(spin, nodes):
    stranger = Stranger(spin)
    stranger.see(nodes, NODES, 0.0, "nothing")
    topics = sorted({one for name in NODES for one in stranger.topics(name)})
    sent = sum(attack(stranger, nodes, topic, kind, extremes) for topic, kind in topics)
    print(f"{sent} messages on {len(topics)} topics")
    assert sent > 1000
    before = {name: memory(nodes.processes[name].pid) / 1e6 for name in NODES}
    for topic, kind in topics:
        attack(stranger, nodes, topic, kind, long_ones)
    for name in NODES:
        after = memory(nodes.processes[name].pid) / 1e6
        refused = {k: v for k, v in stranger.alive[name][1].items() if k.startswith("refused on")}
        print(f"{name}: {before[name]:.0f} -> {after:.0f} MB, {refused}")
        assert after < before[name] + GROWTH, name


def attack(stranger, nodes, topic, kind, changes):
    """Publish all changes of a plausible message on a topic; return how many there are."""
    package, _, name = kind.split("/")
    of = getattr(import_module(f"{package}.msg"), name)
    latched = topic.lstrip("/").startswith(RESULTS)
    qos = LATCHED if latched else QoSProfile(depth=5)
    publisher = stranger.create_publisher(of, topic, qos)
    stranger.spin(stranger, publisher.get_subscription_count, timeout=20.0)
    good, begun, sent = plausible(of), monotonic(), 0
    for path, value in changes(good):
        message = changed(good, path, value)
        if "stamp" not in path and hasattr(message, "header"):
            message.header.stamp = stranger.get_clock().now().to_msg()
        publisher.publish(message)
        sent += 1
        stranger.spin(stranger, lambda: True)
    stranger.see(nodes, NODES, begun, topic)
    stranger.destroy_publisher(publisher)
    return sent


def long_ones(message):
    """Those of the extremes that are long."""
    return ((path, x) for path, x in extremes(message) if hasattr(x, "__len__") and len(x) == MANY)
