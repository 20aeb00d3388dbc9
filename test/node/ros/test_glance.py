"""A topic that is looked at when its last message is wanted."""

import pytest
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from running import wait_until
from std_msgs.msg import Float64

from fss_arm_ros.door import refusals
from fss_arm_ros.glance import Glance


@pytest.mark.parametrize("reliability", [1, 2], ids=["reliable", "best_effort"])
def test_only_the_last_message_is_taken_and_only_once(spin, reliability):
    talker, listener, seen, heard = Node("talker"), Node("listener"), [], []
    glance = Glance(listener, Float64, "number", lambda message: seen.append(message.data))
    qos = QoSProfile(depth=10, reliability=ReliabilityPolicy(reliability))
    talker.create_subscription(Float64, "number", lambda message: heard.append(message.data), qos)
    publisher = talker.create_publisher(Float64, "number", qos)
    spin([talker, listener], lambda: publisher.get_subscription_count() == 2)
    glance.look()
    assert not seen
    for data in (1.0, 2.0, 3.0):
        publisher.publish(Float64(data=data))
    spin(talker, lambda: 3.0 in heard)
    spin(talker, lambda: glance.look() or 3.0 in seen)
    glance.look()
    assert seen == [3.0]


def test_an_executor_hears_nothing_of_it(spin):
    talker, listener, seen = Node("talker"), Node("listener"), []
    glance = Glance(listener, Float64, "number", lambda message: seen.append(message.data))
    publisher = talker.create_publisher(Float64, "number", 10)
    spin([talker, listener], publisher.get_subscription_count)
    for _ in range(100):
        publisher.publish(Float64(data=1.0))
        spin([talker, listener], lambda: True)
    assert not seen
    wait_until(lambda: glance.look() or seen, 10.0, lambda: None)
    assert seen == [1.0]


def test_the_door_is_kept(spin):
    talker, listener, seen = Node("talker"), Node("listener"), []
    glance = Glance(listener, Odometry, "base/state", seen.append)
    publisher = talker.create_publisher(Odometry, "base/state", 10)
    spin([talker, listener], publisher.get_subscription_count)
    wrong = Odometry()
    wrong.pose.pose.position.x = 1e308
    publisher.publish(wrong)
    spin(talker, lambda: glance.look() or refusals(listener))
    assert not seen
