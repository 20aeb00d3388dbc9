"""Subscriptions that match any publisher; diagnostics."""

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int64

from fss_arm_ros.diagnostics import ERROR, Diagnostics, Health
from fss_arm_ros.qos import SENSOR, subscribe_sensor

BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


def test_a_best_effort_publisher_is_heard_and_a_reliable_one_goes_on(spin):
    ear, reliable, loose, got = Node("ear"), Node("reliable"), Node("loose"), []
    subscribe_sensor(ear, Int64, "topic", lambda m: got.append(m.data))
    first = reliable.create_publisher(Int64, "topic", SENSOR)
    spin([ear, reliable, loose], first.get_subscription_count)
    for k in range(4, 500):
        first.publish(Int64(data=k))
    spin(ear, lambda: got == list(range(4, 500)))
    second = loose.create_publisher(Int64, "topic", BEST_EFFORT)
    spin(ear, second.get_subscription_count)
    spin(ear, first.get_subscription_count)
    loose.create_timer(0.01, lambda: second.publish(Int64(data=2)))
    reliable.create_timer(0.01, lambda: first.publish(Int64(data=3)))
    spin(ear, lambda: {2, 3} <= set(got))


def test_diagnostics_tell_name_level_and_counts(spin):
    node, got = Node("thing", namespace="fss2"), []
    node.create_subscription(DiagnosticArray, "/diagnostics", got.append, 10)
    Diagnostics(node, lambda: Health(ERROR, "lost", {"frames": 3, "age": 0.25}), "link 1")
    status = spin(node, lambda: got)[0].status[0]
    assert (status.name, status.level, status.message) == ("/fss2/thing", ERROR, "lost")
    assert status.hardware_id == "link 1"
    assert {v.key: v.value for v in status.values} == {"frames": "3", "age": "0.25"}
