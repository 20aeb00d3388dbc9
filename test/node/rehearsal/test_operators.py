"""Operator of a rehearsal: isolated domain, and no arming next to foreign drivers."""

import os
from unittest.mock import patch

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from running import DOMAIN, wait_until
from std_srvs.srv import SetBool

from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR
from fss_rehearsal import operators
from fss_rehearsal.domain import Domain, reserve
from fss_rehearsal.processes import RehearsalError


class Arm:
    """Driver and arm of an enclave, with the received arm requests."""

    def __init__(self, enclave):
        self.requests, self.context = [], Context()
        arguments = ["--ros-args", "--enclave", enclave]
        rclpy.init(args=arguments, context=self.context, domain_id=DOMAIN)
        self.node = Node("arm", context=self.context)
        self.node.create_service(SetBool, "arm/enable", self.on_arm)
        self.node.create_publisher(LinkTelemetry, "link_1/telemetry", SENSOR)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def on_arm(self, request, response):
        self.requests.append(request.data)
        return response

    def spin(self):
        self.executor.spin_once(timeout_sec=0.02)


@pytest.fixture
def arm():
    """arm(enclave): return a new arm in this test's domain."""
    arms = []

    def make(enclave):
        arms.append(Arm(enclave))
        return arms[-1]

    yield make
    for each in arms:
        each.executor.shutdown()
        each.node.destroy_node()
        each.context.shutdown()


@pytest.fixture
def rehearsal():
    """Operator of a rehearsal in this test's domain."""
    domain = Domain(DOMAIN, "/rehearsal_1", None)
    rclpy.init(args=["--ros-args", "--enclave", domain.enclave], domain_id=DOMAIN)
    node = operators.Operator(domain)
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_domain_with_a_foreign_node_is_skipped(arm):
    """The node started after the check of the ports."""
    arm("/")
    free = reserve(range(66, 102))
    domains = iter([Domain(DOMAIN, "/rehearsal_1", None), next(free)])
    with (
        patch.dict(os.environ),
        patch.object(operators, "reserve", lambda: domains),
        operators.isolated_domain() as domain,
    ):
        assert domain.number != DOMAIN
        assert os.environ["ROS_DOMAIN_ID"] == str(domain.number)
        assert rclpy.utilities.get_default_context().get_domain_id() == domain.number
    rclpy.try_shutdown()


def test_an_arm_of_this_rehearsal_is_armed(arm, rehearsal):
    own_arm = arm("/rehearsal_1")

    def step():
        rehearsal.keep_armed()
        rclpy.spin_once(rehearsal, timeout_sec=0.02)
        own_arm.spin()

    wait_until(lambda: own_arm.requests, 20.0, step)
    assert set(own_arm.requests) == {True}


def test_nothing_is_armed_while_a_foreign_node_drives_links(arm, rehearsal):
    own_arm, foreign_arm = arm("/rehearsal_1"), arm("/")
    wait_until(
        lambda: (
            ("arm", "/", "/") in operators.foreign_nodes(rehearsal, rehearsal.domain)
            and rehearsal.arm.service_is_ready()
            and rehearsal.drives_links("arm", "/")
        ),
        20.0,
        lambda: rclpy.spin_once(rehearsal, timeout_sec=0.02),
    )
    with pytest.raises(RehearsalError, match=f"node /arm in ROS domain {DOMAIN} drives links, too"):
        rehearsal.keep_armed()
    for _ in range(20):
        foreign_arm.spin()
        own_arm.spin()
    assert own_arm.requests == foreign_arm.requests == []


def test_a_foreign_viewer_does_not_prevent_arming(arm, rehearsal):
    own_arm, context = arm("/rehearsal_1"), Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    viewer = Node("view", context=context)
    wait_until(
        lambda: list(operators.foreign_nodes(rehearsal, rehearsal.domain)),
        20.0,
        lambda: rclpy.spin_once(rehearsal, timeout_sec=0.02),
    )
    assert rehearsal.is_only_driver()
    assert not own_arm.requests
    viewer.destroy_node()
    context.shutdown()
