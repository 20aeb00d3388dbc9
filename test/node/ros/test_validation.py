"""Validation of a subscription: what passes, what is refused, and what is said of it."""

import gc
from math import inf, nan
from types import SimpleNamespace
from weakref import ref

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, JointState

from fss_arm_msgs.msg import Calibration, KinematicCalibration, LinkTelemetry
from fss_arm_ros.diagnostics import WARN, Diagnostics, Health
from fss_arm_ros.rules import Rule
from fss_arm_ros.sources import duplicate_publishers
from fss_arm_ros.validation import Validator, check, refusals, subscribe


def odometry(**numbers):
    message = Odometry()
    message.pose.pose.orientation.w = numbers.get("w", 1.0)
    message.pose.pose.position.x = numbers.get("x", 0.0)
    message.twist.covariance[35] = numbers.get("covariance", 0.0)
    return message


def stamped(sec, nanosec=0):
    message = Imu()
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    return message


def pose(x):
    message = PoseStamped()
    message.pose.position.x = x
    return message


def calibration(**fields):
    return KinematicCalibration(calibration=Calibration(**fields))


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (JointState(name=["a", "b"], position=[1.0, nan], effort=[inf, 0.0]), ""),
        (JointState(name=["a", "b"], position=[1.0]), "has 1 elements, expected 2, or none"),
        (JointState(name=["a"], velocity=[1e308]), "velocity is 1e+308, expected at most 1e+12"),
        (odometry(), ""),
        (odometry(x=nan), "x is nan, expected a number"),
        (odometry(covariance=inf), "covariance is inf, expected at most"),
        (odometry(w=0.0), "pose has no orientation"),
        (pose(nan), ""),
        (pose(-1e200), "x is -1e+200, expected at most"),
        (stamped(-1), "a time is -1 s and 0 ns, expected one from 1970 on"),
        (stamped(1, 1_000_000_000), "a time is 1 s and 1000000000 ns"),
        (LinkTelemetry(round_trip=nan, clock_deviation=inf), ""),
        (calibration(names=["a"], deviations=[inf], covariance=[nan]), ""),
        (calibration(names=["a"], covariance=[1.0, 0.0]), "covariance has 2 elements, expected 1"),
        (calibration(names=["a"], values=[1.0, 2.0]), "values has 2 elements, expected 1"),
    ],
)
def test_what_is_let_in(message, why):
    found = check(type(message))(message)
    assert why in found
    assert bool(why) == bool(found)


def test_a_subscriber_gives_a_rule_of_its_own(spin):
    node, received = Node("listener"), []
    rule = Rule(also=(lambda message: "" if message.name == ["joint_1"] else "another joint",))
    subscribe(node, JointState, "joint_states", received.append, 10, rule)
    publisher = node.create_publisher(JointState, "joint_states", 10)
    spin(node, publisher.get_subscription_count)
    for name, position in (("joint_2", 0.0), ("joint_1", nan), ("joint_1", 1.0)):
        publisher.publish(JointState(name=[name], position=[position]))
    spin(node, lambda: received)
    assert received[0].position[0] == 1.0
    assert refusals(node) == {"refused on joint_states": 2}


def test_a_node_counts_what_it_refuses_and_goes_on(spin):
    node, heard = Node("listener"), []
    subscribe(node, JointState, "joint_states", heard.append, 10)
    publisher = node.create_publisher(JointState, "joint_states", 10)
    spin(node, publisher.get_subscription_count)
    for position in ([1.0], [1.0, 2.0], 9000 * [1.0]):
        publisher.publish(JointState(name=["joint_1"], position=position))
    last = serialize_message(JointState(name=["joint_1"], position=[3.0], effort=[0.0]))
    for data in (last[:40], b"\0\1", last):
        publisher.publish(data)
    spin(node, lambda: len(heard) == 2)
    assert [message.position[0] for message in heard] == [1.0, 3.0]
    assert refusals(node) == {"refused on joint_states": 4}


def test_what_is_refused_between_what_is_not_is_logged_but_once_in_a_while(ros, monkeypatch):
    node, said = Node("listener"), []
    logger = SimpleNamespace(warning=said.append)
    monkeypatch.setattr(node, "get_logger", lambda: logger)
    validator, whole = Validator(node, Imu, "fog/imu"), serialize_message(stamped(1))
    for data in 20 * (whole, whole[:100]):
        validator.message(data)
    assert validator.refused == 20
    assert said == ["a message on fog/imu is refused: its 100 bytes are no sensor_msgs/Imu"]


def test_a_node_that_nobody_holds_is_gone_with_its_validators(ros):
    node = Node("forgotten")
    subscribe(node, JointState, "joint_states", print, 10)
    known = ref(node)
    node.destroy_node()
    del node
    gc.collect()
    assert known() is None


class Source(Node):
    """A node that publishes some topics."""

    def __init__(self, name, *topics):
        super().__init__(name)
        for topic, kind in topics:
            self.create_publisher(kind, topic, 10)


def test_two_sources_of_a_measurement_are_named(spin):
    listener, heard = Node("listener"), []
    subscribe(listener, PoseStamped, "vicon/fss/fss", heard.append, 10)
    subscribe(listener, JointState, "arm/joint_commands", heard.append, 10)
    Diagnostics(listener, lambda: Health(b"\0", "as ever"))
    said, user = [], Node("user")
    user.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: said.append(m.status[0]), 10
    )
    users = [
        Source(name, ("vicon/fss/fss", PoseStamped), ("arm/joint_commands", JointState))
        for name in ("mocap", "testbed")
    ]
    words = "vicon/fss/fss has 2 sources: /mocap, /testbed"
    spin([listener, user, *users], lambda: said and said[-1].message == f"{words}; as ever")
    assert said[-1].level == WARN
    users.pop().destroy_node()
    spin([listener, user, *users], lambda: said[-1].message == "as ever")


def test_links_share_a_topic_and_a_replay_beside_them_does_not(spin):
    listener = Node("listener")
    subscribe(listener, JointState, "joint_states", print, 10)
    links = [
        Source(f"link_{i}", ("joint_states", JointState), (f"link_{i}/telemetry", LinkTelemetry))
        for i in (1, 2)
    ]
    spin([listener], lambda: listener.count_publishers("joint_states") == 2)
    spin([listener], lambda: not duplicate_publishers(listener))
    replay = Source("replay", ("joint_states", JointState), ("link_1/telemetry", LinkTelemetry))
    expected = "joint_states has 3 sources: /link_1, /link_2, /replay"
    spin([listener], lambda: duplicate_publishers(listener) == expected)
    for node in (*links, replay):
        node.destroy_node()
