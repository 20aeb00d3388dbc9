"""A node whose description has another number of joints than the arm that runs ends."""

from dataclasses import replace

import pytest
from model_arms import short_arm
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fss_arm_calib.experiment.experiment_node import ExperimentNode
from fss_arm_driver.arm_node import ArmNode
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.urdf import urdf
from fss_arm_ros.described_arm import (
    JointCount,
    count_joints,
    describe_joint_mismatch,
    load_described_arm,
)
from fss_arm_ros.qos import LATCHED, SENSOR


def arm_of(n: int) -> Arm:
    return replace(paper_arm(), links=paper_arm().links[:n])


MISMATCH = "the arm has 3 joints, description 'paper' has 4; give -p arm:=..."


@pytest.mark.parametrize("n", [1, 3, 4])
def test_joints_of_a_urdf_are_counted(n):
    assert count_joints(urdf(arm_of(n))) == n


@pytest.mark.parametrize("text", ["", "arm", "<joint", "<robot><joint name='slider'/></robot>"])
def test_a_text_without_joints_of_an_arm_decides_nothing(text):
    assert count_joints(text) == 0
    assert describe_joint_mismatch(0, paper_arm()) == ""


def test_a_mismatch_names_both_numbers_and_the_option():
    assert describe_joint_mismatch(4, paper_arm()) == ""
    assert describe_joint_mismatch(3, paper_arm()) == MISMATCH


def test_silent_joints_are_not_missing_but_further_joints_count():
    count = JointCount(2)
    assert [count.add([i]) for i in (1, 1, 1, 1)] == [2] * 4
    assert not count.settled
    assert [count.add([i]) for i in (2, 2, 2)] == [2] * 3
    assert count.settled
    assert count.add([3]) == 3


@pytest.fixture
def publish(spin):
    """publish(topic, message, qos): publish as another node does."""
    node = Node("publisher")
    spin(node, lambda: True)
    return lambda topic, message, qos: node.create_publisher(type(message), topic, qos).publish(
        message
    )


def reason_to_end(spin, node):
    with pytest.raises(SystemExit) as end:
        spin(node, lambda: False, 5.0)
    return end.value.code


def test_an_experiment_with_the_wrong_arm_ends_in_one_line(spin, publish):
    publish("robot_description", String(data=urdf(arm_of(3))), LATCHED)
    node = ExperimentNode(parameter_overrides=[Parameter("postures", value=[0.1] * 4)])
    node.close = node.move_client.destroy
    assert reason_to_end(spin, node) == MISMATCH


def test_the_first_description_decides(spin, publish):
    node = Node("navigation")
    assert load_described_arm(node, "") == paper_arm()
    heard = []
    node.create_subscription(String, "robot_description", heard.append, LATCHED)
    for n in (4, 3):
        publish("robot_description", String(data=urdf(arm_of(n))), LATCHED)
        spin(node, lambda: heard)
        heard.clear()


def test_the_arm_node_ends_if_more_joints_are_driven(spin, publish, tmp_path):
    node = ArmNode(parameter_overrides=[Parameter("arm", value=str(short_arm(3, tmp_path)))])
    message = JointState(name=["joint_4"], position=[0.0])
    publish("joint_states", message, SENSOR)
    spin(node, lambda: node.count_publishers("joint_states"))
    publish("joint_states", message, SENSOR)
    wanted = "the arm has 4 joints, description 'paper' has 3; give -p arm:=..."
    assert reason_to_end(spin, node) == wanted
