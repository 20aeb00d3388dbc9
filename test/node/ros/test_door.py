"""The door of a subscription: what is let in, what is refused, and what is said of it."""

import gc
from math import inf, nan
from weakref import ref

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState

from fss_arm_msgs.msg import Calibration, KinematicCalibration, LinkTelemetry
from fss_arm_ros.door import check, refusals, subscribe


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


def test_a_node_counts_what_it_refuses_and_goes_on(spin):
    node, heard = Node("listener"), []
    subscribe(node, JointState, "joint_states", heard.append, 10)
    publisher = node.create_publisher(JointState, "joint_states", 10)
    spin(node, publisher.get_subscription_count)
    for position in ([1.0], [1.0, 2.0], 9000 * [1.0], [3.0]):
        publisher.publish(JointState(name=["joint_1"], position=position))
    spin(node, lambda: len(heard) == 2)
    assert [message.position[0] for message in heard] == [1.0, 3.0]
    assert refusals(node) == {"refused on joint_states": 2}


def test_a_node_that_nobody_holds_is_gone_with_its_doors(ros):
    node = Node("forgotten")
    subscribe(node, JointState, "joint_states", print, 10)
    known = ref(node)
    node.destroy_node()
    del node
    gc.collect()
    assert known() is None
