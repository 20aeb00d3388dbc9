"""Topics whose messages wait until the node takes them."""

from math import nan

import pytest
from rclpy.node import Node
from std_msgs.msg import Float64

from fss_arm_ros.door import refusals
from fss_arm_ros.inbox import Inbox


@pytest.mark.parametrize(("last", "expected"), [(False, [1.0, 2.0, 3.0]), (True, [3.0])])
def test_all_messages_wait_or_the_last_one_alone(spin, last, expected):
    talker, listener, seen, heard = Node("talker"), Node("listener"), [], []
    inbox = Inbox(listener)
    inbox.listen(Float64, "number", lambda message: seen.append(message.data), last)
    talker.create_subscription(Float64, "number", lambda message: heard.append(message.data), 10)
    publisher = talker.create_publisher(Float64, "number", 10)
    spin([talker, listener], lambda: publisher.get_subscription_count() == 2)
    for data in (1.0, 2.0, 3.0):
        publisher.publish(Float64(data=data))
    spin([talker, listener], lambda: 3.0 in heard)
    assert not seen
    spin(talker, lambda: inbox.take() or 3.0 in seen)
    assert seen == expected


def test_what_the_rule_of_the_type_forbids_is_refused_and_counted(spin):
    talker, listener, seen = Node("talker"), Node("listener"), []
    inbox = Inbox(listener)
    inbox.listen(Float64, "number", lambda message: seen.append(message.data))
    publisher = talker.create_publisher(Float64, "number", 10)
    spin([talker, listener], publisher.get_subscription_count)
    for data in (nan, 1.0):
        publisher.publish(Float64(data=data))
    spin(talker, lambda: inbox.take() or seen)
    assert seen == [1.0]
    assert refusals(listener) == {"refused on number": 1}
