"""Subscriptions that the executor does not handle: polled, or in a thread of their own."""

from threading import get_ident

import pytest
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from fss_arm_ros.subscriptions import PolledSubscription, SubscriptionThread, Topic
from fss_arm_ros.validation import refusals

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT


class Listener(Node):
    """Hears numbers, and fails at negative ones."""

    def __init__(self):
        super().__init__("listener")
        self.heard = []
        topic = Topic(Float64, "number", QoSProfile(depth=10), self.take)
        self.thread = SubscriptionThread(self, [topic])

    def take(self, message):
        if message.data < 0.0:
            raise ValueError("negative")
        self.heard.append((message.data, get_ident()))

    def close(self):
        self.thread.close()


@pytest.fixture
def talk(spin):
    listener, talker = Listener(), Node("talker")
    publisher = talker.create_publisher(Float64, "number", 10)
    spin([listener, talker], publisher.get_subscription_count)
    return listener, lambda number: publisher.publish(Float64(data=number))


def test_messages_are_taken_in_order_and_in_one_thread(talk, spin):
    listener, say = talk
    for number in range(5):
        say(float(number))
    spin(listener, lambda: len(listener.heard) == 5)
    assert [number for number, _ in listener.heard] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert {thread for _, thread in listener.heard} == {listener.thread.ident}


def test_what_goes_wrong_comes_up_in_the_executor(talk, spin):
    listener, say = talk
    say(-1.0)
    with pytest.raises(ValueError, match="negative"):
        spin(listener, lambda: False)


def test_it_ends_with_its_context(talk):
    listener, _ = talk
    listener.context.shutdown()
    listener.thread.join(5.0)
    assert not listener.thread.is_alive()


@pytest.mark.parametrize("reliability", [RELIABLE, BEST_EFFORT], ids=["reliable", "best_effort"])
@pytest.mark.parametrize(("depth", "expected"), [(None, [3.0]), (10, [1.0, 2.0, 3.0])])
def test_polled_are_all_messages_that_its_queue_holds_and_once(spin, reliability, depth, expected):
    talker, listener, seen, heard = Node("talker"), Node("listener"), [], []
    held = (QoSProfile(depth=depth, reliability=BEST_EFFORT),) if depth else ()
    polled = PolledSubscription(
        listener, Float64, "number", lambda message: seen.append(message.data), *held
    )
    qos = QoSProfile(depth=10, reliability=reliability)
    talker.create_subscription(Float64, "number", lambda message: heard.append(message.data), qos)
    publisher = talker.create_publisher(Float64, "number", qos)
    spin([talker, listener], lambda: publisher.get_subscription_count() == 2)
    polled.poll()
    for data in (1.0, 2.0, 3.0):
        publisher.publish(Float64(data=data))
    spin([talker, listener], lambda: 3.0 in heard)
    assert not seen  # an executor hears nothing of it
    spin(talker, lambda: polled.poll() or 3.0 in seen)
    polled.poll()
    assert seen == expected


def test_what_is_polled_is_validated(spin):
    talker, listener, seen = Node("talker"), Node("listener"), []
    polled = PolledSubscription(listener, Odometry, "base/state", seen.append)
    publisher = talker.create_publisher(Odometry, "base/state", 10)
    spin([talker, listener], publisher.get_subscription_count)
    wrong = Odometry()
    wrong.pose.pose.position.x = 1e308
    publisher.publish(wrong)
    spin(talker, lambda: polled.poll() or refusals(listener))
    assert not seen
