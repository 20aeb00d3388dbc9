"""What is called, and what is not, when it comes, ends or waits within a turn."""

import time

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from running import wait_until
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from fss_arm_ros.executor import BATCH, BatchExecutor

DEEP = QoSProfile(depth=1000)


@pytest.fixture
def node(ros):
    node = Node("spun")
    yield node
    node.destroy_node()


@pytest.fixture
def executor(node):
    executor = BatchExecutor()
    executor.add_node(node)
    yield executor
    executor.remove_node(node)


@pytest.fixture
def turn(executor):
    """turn(done): until it holds."""
    return lambda done: wait_until(done, 10.0, lambda: executor.spin_once(0.02))


def sent(node, numbers):
    """A publisher that has sent these."""
    publisher = node.create_publisher(Int32, "numbers", DEEP)
    for number in numbers:
        publisher.publish(Int32(data=number))
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    return publisher


def test_all_that_has_come_is_handed_over_in_order(node, turn):
    heard, turns = [], []
    node.create_subscription(Int32, "numbers", lambda m: heard.append(m.data), DEEP)
    sent(node, range(3 * BATCH))
    turn(lambda: turns.append(0) or len(heard) == 3 * BATCH)
    assert heard == list(range(3 * BATCH))
    assert len(turns) < BATCH  # one message a turn would take three times that


def test_what_is_made_while_it_spins_is_called(node, turn):
    heard = []

    def make():
        timer.cancel()
        node.create_subscription(Int32, "numbers", lambda m: heard.append(m.data), DEEP)

    timer = node.create_timer(0.001, make)
    publisher = node.create_publisher(Int32, "numbers", DEEP)
    turn(lambda: publisher.publish(Int32(data=7)) or 7 in heard)


def test_what_is_destroyed_in_a_turn_is_not_called_any_more(node, turn):
    heard, ticks = [], []

    def hear(message):
        heard.append(message.data)
        node.destroy_subscription(subscription)
        node.destroy_timer(timer)

    subscription = node.create_subscription(Int32, "numbers", hear, DEEP)
    sent(node, range(5))
    timer = node.create_timer(0.001, lambda: ticks.append(0))
    turn(lambda: heard)
    before, end = len(ticks), time.monotonic() + 0.05
    turn(lambda: time.monotonic() > end)
    assert heard == [0]
    assert len(ticks) == before


def test_a_request_that_waits_lets_all_else_go_on(node, turn):
    may_answer, heard = Future(), []

    async def answer(_, response):
        response.message = await may_answer
        return response

    group = ReentrantCallbackGroup()
    node.create_service(Trigger, "ask", answer, callback_group=group)
    node.create_subscription(Int32, "numbers", lambda m: heard.append(m.data), DEEP)
    client = node.create_client(Trigger, "ask")
    assert client.wait_for_service(10.0)
    first, second = client.call_async(Trigger.Request()), client.call_async(Trigger.Request())
    sent(node, range(3))
    turn(lambda: len(heard) == 3)
    assert not first.done()
    may_answer.set_result("now")
    turn(lambda: first.done() and second.done())
    assert (first.result().message, second.result().message) == ("now", "now")


@pytest.mark.parametrize("way", ["subscription", "timer", "task"])
def test_an_error_ends_the_turn_and_is_raised(node, executor, turn, way):

    def fail(*_):
        raise ValueError(way)

    if way == "subscription":
        node.create_subscription(Int32, "numbers", fail, DEEP)
        sent(node, [1])
    elif way == "timer":
        node.create_timer(0.001, fail)
    else:
        executor.create_task(fail)
    with pytest.raises(ValueError, match=way):
        turn(lambda: False)


def test_a_turn_without_anything_ends_in_time(executor):
    executor.spin_once(0.0)  # gathers
    begun = time.monotonic()
    executor.spin_once(0.05)
    assert time.monotonic() - begun < 5.0
