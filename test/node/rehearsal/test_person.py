"""The operator of a rehearsal: alone in its domain, and without a hand on others' links."""

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
from fss_rehearsal import person
from fss_rehearsal.domain import Domain, reserve
from fss_rehearsal.processes import RehearsalError


class Arm:
    """Somebody's driver and arm, and what the arm is asked for."""

    def __init__(self, enclave):
        self.asked, self.context = [], Context()
        given = ["--ros-args", "--enclave", enclave]
        rclpy.init(args=given, context=self.context, domain_id=DOMAIN)
        self.node = Node("arm", context=self.context)
        self.node.create_service(SetBool, "arm/enable", self.on_arm)
        self.node.create_publisher(LinkTelemetry, "link_1/telemetry", SENSOR)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def on_arm(self, request, response):
        self.asked.append(request.data)
        return response

    def spin(self):
        self.executor.spin_once(timeout_sec=0.02)


@pytest.fixture
def arm():
    """arm(enclave): somebody's arm in this test's domain."""
    made = []

    def make(enclave):
        made.append(Arm(enclave))
        return made[-1]

    yield make
    for one in made:
        one.executor.shutdown()
        one.node.destroy_node()
        one.context.shutdown()


@pytest.fixture
def rehearsal():
    """A domain, which is that of this test, entered by the rehearsal."""
    domain = Domain(DOMAIN, "/rehearsal_1", None)
    rclpy.init(args=["--ros-args", "--enclave", domain.enclave], domain_id=DOMAIN)
    node = person.Operator(domain)
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_domain_where_somebody_answers_is_left_for_the_next(arm):
    """Somebody whom the ports did not tell of: who came after the look at them."""
    arm("/")
    free = reserve(range(66, 102))
    domains = iter([Domain(DOMAIN, "/rehearsal_1", None), next(free)])
    with (
        patch.dict(os.environ),
        patch.object(person, "reserve", lambda: domains),
        person.own_domain() as domain,
    ):
        assert domain.number != DOMAIN
        assert os.environ["ROS_DOMAIN_ID"] == str(domain.number)
        assert rclpy.utilities.get_default_context().get_domain_id() == domain.number
    rclpy.try_shutdown()


def test_an_arm_of_this_rehearsal_is_armed(arm, rehearsal):
    own = arm("/rehearsal_1")

    def step():
        rehearsal.keep_armed()
        rclpy.spin_once(rehearsal, timeout_sec=0.02)
        own.spin()

    wait_until(lambda: own.asked, 20.0, step)
    assert set(own.asked) == {True}


def test_nothing_is_armed_while_somebody_else_drives_links_in_the_domain(arm, rehearsal):
    own, other = arm("/rehearsal_1"), arm("/")
    wait_until(
        lambda: (
            len(list(person.strangers(rehearsal, rehearsal.domain))) == 1
            and rehearsal.arm.service_is_ready()
            and rehearsal.drives("arm", "/")
        ),
        20.0,
        lambda: rclpy.spin_once(rehearsal, timeout_sec=0.02),
    )
    with pytest.raises(RehearsalError, match=f"node /arm in ROS domain {DOMAIN} drives links, too"):
        rehearsal.keep_armed()
    for _ in range(20):
        other.spin()
        own.spin()
    assert own.asked == other.asked == []


def test_somebody_who_only_looks_on_does_not_disturb(arm, rehearsal):
    own, context = arm("/rehearsal_1"), Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    viewer = Node("view", context=context)
    wait_until(
        lambda: list(person.strangers(rehearsal, rehearsal.domain)), 20.0,
        lambda: rclpy.spin_once(rehearsal, timeout_sec=0.02),
    )  # fmt: skip
    assert rehearsal.drives_alone()
    assert not own.asked
    viewer.destroy_node()
    context.shutdown()
