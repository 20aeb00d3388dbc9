"""How a node's program ends."""

import subprocess
import sys

from conftest import wait_until
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from fss_arm_ros.executor import BatchExecutor

KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)

TOLD = """
import os, signal, sys, time
import rclpy
from rclpy.node import Node
from fss_arm_ros.run import run

def make():
    os.kill(os.getpid(), signal.SIGTERM)
    while rclpy.ok():
        time.sleep(0.01)
    return Node("late")

sys.exit(run(make))
"""


def test_told_to_end_while_it_is_made_it_ends_well():
    ended = subprocess.run([sys.executable, "-c", TOLD], capture_output=True, text=True, timeout=30)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_request_is_answered_after_all_that_came_before_it(ros):
    node, heard, answered = Node("busy"), [], []
    publisher = node.create_publisher(Empty, "much", KEEP_ALL)
    node.create_subscription(Empty, "much", heard.append, KEEP_ALL)

    def answer(_, response):
        answered.append(len(heard))
        return response

    node.create_service(Trigger, "count", answer)
    client = node.create_client(Trigger, "count")
    assert client.wait_for_service(10.0)
    for _ in range(300):
        publisher.publish(Empty())
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    future = client.call_async(Trigger.Request())
    executor = BatchExecutor()
    executor.add_node(node)
    wait_until(future.done, 10.0, lambda: executor.spin_once(timeout_sec=0.02))
    assert answered == [300]
    node.destroy_node()
