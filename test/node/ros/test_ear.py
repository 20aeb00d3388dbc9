"""A thread that listens to one topic, beside an executor that does not."""

from threading import get_ident

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from running import wait_until
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from fss_arm_ros.ear import Ear
from fss_arm_ros.executor import BatchExecutor


class Listener(Node):
    """Hears numbers, and fails at negative ones."""

    def __init__(self):
        super().__init__("listener")
        self.heard = []
        self.ear = Ear(self, Float64, "number", QoSProfile(depth=10), self.take)

    def take(self, message):
        if message.data < 0.0:
            raise ValueError("negative")
        self.heard.append((message.data, get_ident()))

    def close(self):
        self.ear.close()


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
    assert {thread for _, thread in listener.heard} == {listener.ear.ident}


def test_an_executor_leaves_its_messages_alone_also_when_it_answers(ros):
    """Which is when ours hands over all messages first."""
    listener, executor = Listener(), BatchExecutor()
    listener.ear.close()
    talker = Node("talker")
    publisher = talker.create_publisher(Float64, "number", 10)
    listener.create_service(Trigger, "ask", lambda _, answer: answer)
    asker = talker.create_client(Trigger, "ask")
    for node in (listener, talker):
        executor.add_node(node)

    def ready():
        return publisher.get_subscription_count() and asker.service_is_ready()

    wait_until(ready, 10.0, lambda: executor.spin_once(timeout_sec=0.02))
    publisher.publish(Float64(data=1.0))
    answer = asker.call_async(Trigger.Request())
    wait_until(answer.done, 10.0, lambda: executor.spin_once(timeout_sec=0.02))
    assert not listener.heard
    executor.shutdown()
    for node in (listener, talker):
        node.destroy_node()


def test_what_goes_wrong_comes_up_in_the_executor(talk, spin):
    listener, say = talk
    say(-1.0)
    with pytest.raises(ValueError, match="negative"):
        spin(listener, lambda: False)


def test_it_ends_with_its_context(talk):
    listener, _ = talk
    listener.context.shutdown()
    listener.ear.join(5.0)
    assert not listener.ear.is_alive()
