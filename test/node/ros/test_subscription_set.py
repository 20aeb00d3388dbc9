"""Subscriptions that an executor handles together, on rclpy's own executor."""

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Empty, Int32
from std_srvs.srv import Trigger

from fss_arm_ros.subscription_set import (
    MAX_BATCH,
    receive_pending,
    subscribe_bytes,
    unsubscribe,
)

DEEP = QoSProfile(depth=1000)
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def number(data):
    return deserialize_message(data, Int32).data


def send(node, numbers, topic="numbers"):
    """Publish numbers and wait until every reliable subscriber has received them."""
    publisher = node.create_publisher(Int32, topic, DEEP)
    for value in numbers:
        publisher.publish(Int32(data=value))
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    return publisher


def test_messages_arrive_complete_and_in_order(spin):
    node, received = Node("receiver"), []
    subscribe_bytes(node, Int32, "numbers", lambda data: received.append(number(data)), DEEP)
    send(node, range(3 * MAX_BATCH))
    spin(node, lambda: len(received) == 3 * MAX_BATCH)
    assert received == list(range(3 * MAX_BATCH))


def test_a_busy_topic_leaves_the_others_their_turn(spin):
    node, received = Node("receiver"), []
    subscribe_bytes(node, Int32, "busy", lambda data: received.append("busy"), DEEP)
    subscribe_bytes(node, Int32, "quiet", lambda data: received.append("quiet"), DEEP)
    send(node, range(4 * MAX_BATCH), "busy")
    send(node, [1], "quiet")
    spin(node, lambda: len(received) == 4 * MAX_BATCH + 1)
    assert received.index("quiet") <= MAX_BATCH


def test_subscriptions_may_be_added_while_the_node_spins(spin):
    node, received = Node("receiver"), []
    subscribe_bytes(node, Int32, "unused", lambda data: None, DEEP)

    def add():
        timer.cancel()
        subscribe_bytes(node, Int32, "numbers", lambda data: received.append(number(data)), DEEP)

    timer = node.create_timer(0.001, add)
    publisher = node.create_publisher(Int32, "numbers", DEEP)
    spin(node, lambda: publisher.publish(Int32(data=7)) or 7 in received)


def test_a_subscription_removed_by_its_callback_receives_nothing_further(spin):
    node, received = Node("receiver"), []

    def receive(data):
        received.append(number(data))
        unsubscribe(node, subscription)

    subscription = subscribe_bytes(node, Int32, "numbers", receive, DEEP)
    send(node, range(5))
    other = []
    subscribe_bytes(node, Int32, "other", lambda data: other.append(data), DEEP)
    send(node, [1], "other")
    spin(node, lambda: other)
    assert received == [0]


def test_an_error_in_a_callback_is_raised_by_the_executor(spin):
    node = Node("receiver")

    def fail(data):
        raise ValueError("callback failed")

    subscribe_bytes(node, Int32, "numbers", fail, DEEP)
    send(node, [1])
    with pytest.raises(ValueError, match="callback failed"):
        spin(node, lambda: False)


def test_a_request_can_be_answered_after_every_message_received_before_it(spin):
    node, received, answered = Node("receiver"), [], []
    subscribe_bytes(node, Empty, "messages", received.append, KEEP_ALL)

    def answer(_, response):
        receive_pending(node)
        answered.append(len(received))
        return response

    node.create_service(Trigger, "count", answer)
    client = node.create_client(Trigger, "count")
    assert client.wait_for_service(10.0)
    publisher = node.create_publisher(Empty, "messages", KEEP_ALL)
    for _ in range(300):
        publisher.publish(Empty())
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    future = client.call_async(Trigger.Request())
    spin(node, future.done)
    assert answered == [300]


def test_events_of_a_subscription_are_handled(spin):
    node, events = Node("receiver"), []
    subscribe_bytes(
        node,
        Int32,
        "numbers",
        lambda data: None,
        DEEP,
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=events.append),
    )
    node.create_publisher(Int32, "numbers", BEST_EFFORT)
    node.create_timer(0.1, lambda: None)  # every node of this workspace has one
    spin(node, lambda: events)
