"""A program that knows standard messages alone drives the simulated arm, by each standard way."""

import signal
from itertools import chain, repeat
from time import monotonic

import numpy as np
import pytest
import standard_client
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.duration import Duration
from running import OWN
from standard_client import JOINTS, StandardClient
from std_srvs.srv import SetBool

from fss_rehearsal.processes import Nodes

ENDED = FollowJointTrajectory.Result
LIVES = 4.0  # a command of the arm's node [s]
HOME = (0.0, 0.0, 0.0, 0.0)
THERE = (0.3, -0.2, 0.25, -0.15)


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    with Nodes(tmp_path_factory.mktemp("nodes"), print, OWN) as nodes:
        nodes.start("testbed", "fss_sim", "testbed", ports=OWN.ports(4))
        slack = {"timeout": 4.0, "watchdog": 6.0}  # of a busy computer
        nodes.start("link_1", "fss_arm_driver", "link", urls=OWN.urls(4), **slack)
        nodes.start("arm", "fss_arm_driver", "arm", time_to_live=LIVES)
        yield nodes


class Person:
    """Arms the links and runs the client."""

    def __init__(self, spin, client):
        self.spin, self.client = spin, client
        self.armer = client.create_client(SetBool, "arm/enable")
        self.until(lambda: client.ready() and self.armer.service_is_ready(), 60.0)

    def until(self, condition, timeout=20.0):
        return self.spin(self.client, condition, timeout)

    def after(self, future, timeout=20.0):
        self.until(future.done, timeout)
        return future.result()

    def enable(self, data=True):
        deadline = monotonic() + 40.0  # a computer that starts all this is busy
        while not (answer := self.after(self.armer.call_async(SetBool.Request(data=data)))).success:
            assert monotonic() < deadline, answer.message

    def go(self, goal):
        """Send a goal; its result once it has ended."""
        handle = self.after(self.client.send(goal))
        assert handle.accepted
        return self.after(handle.get_result_async(), 30.0)

    def home(self):
        if not (self.client.resting() and self.client.near(dict.fromkeys(JOINTS, 0.0))):
            ended = self.go(self.client.goal([(2.0, HOME)]))
            assert ended.status == GoalStatus.STATUS_SUCCEEDED, ended.result.error_string
        self.client.feedback.clear()

    def stream(self, condition, *commands):
        """Stream commands at 50 Hz, the last one on and on, until that is seen."""
        deadline = monotonic() + 20.0
        for command in chain(commands, repeat(commands[-1])):
            self.client.command(**command)
            then = monotonic() + 0.02
            self.until(lambda then=then: monotonic() >= then)
            if condition():
                return
            assert then < deadline, f"{command}: {self.client.q}, {self.client.qd}"


@pytest.fixture
def person(spin, nodes):
    nodes.restart_killed()  # by a test that is given one more try
    person = Person(spin, StandardClient())
    person.enable()
    person.home()
    yield person
    person.client.action.destroy()


def test_a_goal_is_reached_with_feedback_whatever_the_order_of_names(person):
    client = person.client
    points = [(1.0, THERE[::-1]), (2.0, np.multiply(1.5, THERE)[::-1]), (3.5, THERE[::-1])]
    ended = person.go(client.goal(points, names=JOINTS[::-1], path=[(j, 0.1) for j in JOINTS]))
    assert (ended.status, ended.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
    assert client.near(dict(zip(JOINTS, THERE, strict=True)))
    feedback = [message.feedback for message in client.feedback]
    assert len(feedback) > 10
    assert feedback[-1].joint_names == list(JOINTS)
    error = np.array([message.error.positions for message in feedback])
    wanted, actual = (
        np.array([getattr(message, kind).positions for message in feedback])
        for kind in ("desired", "actual")
    )
    np.testing.assert_allclose(error, wanted - actual, atol=1e-12)
    assert np.abs(error).max() < 0.03
    assert np.ptp(actual[:, 0]) > 0.3


def stamped(client, seconds):
    return client.get_clock().now() + Duration(seconds=seconds)


def test_a_goal_for_an_arm_that_is_not_armed_is_aborted_with_the_next_step(person):
    person.enable(False)
    person.until(person.client.resting)
    ended = person.go(person.client.goal([(2.0, THERE)])).result
    assert ended.error_code == ENDED.INVALID_GOAL
    assert "not armed: scripts/fss_arm.sh arm" in ended.error_string


def test_a_cancelled_goal_comes_to_rest(person):
    client = person.client
    handle = person.after(client.send(client.goal([(4.0, THERE)])))
    person.until(lambda: client.q["joint_1"] > 0.05)
    person.after(handle.cancel_goal_async())
    ended = person.after(handle.get_result_async())
    assert ended.status == GoalStatus.STATUS_CANCELED
    person.until(client.resting)
    assert 0.05 < client.q["joint_1"] < 0.2


def test_the_topic_of_the_controller_moves_the_arm(person):
    client = person.client
    client.topic.publish(client.trajectory([(2.0, THERE)], stamp=stamped(client, 1.0)))
    person.until(lambda: client.near(dict(zip(JOINTS, THERE, strict=True))) and client.resting())


def test_a_stream_moves_the_joints_that_it_names(person):
    client = person.client
    ramp = [
        {"names": ("joint_3", "joint_1"), "position": (angle, -angle)}
        for angle in np.linspace(0.0, 0.2, 40)
    ]
    there = {"joint_1": -0.2, "joint_2": 0.0, "joint_3": 0.2, "joint_4": 0.0}
    person.stream(lambda: client.near(there, 0.02) and client.resting(), *ramp)
    turning = {"names": ("joint_2",), "velocity": (0.3,)}
    person.stream(lambda: client.qd["joint_2"] == pytest.approx(0.3, abs=0.05), turning)
    person.until(client.resting, 3.0)  # nobody commands any more
    assert 0.02 < client.q["joint_2"] < 0.6
    before = client.q["joint_4"]
    pushing = {"names": ("joint_4",), "effort": (0.5,)}
    person.stream(lambda: client.q["joint_4"] > before + 0.01, pushing)
    person.until(client.resting, 3.0)


def test_a_killed_arm_leaves_links_that_come_to_rest(person, nodes):
    client = person.client
    person.after(client.send(client.goal([(12.0, THERE)])))
    person.until(lambda: client.q["joint_1"] > 0.05)
    nodes.processes["arm"].send_signal(signal.SIGKILL)
    heard = {}
    client.create_subscription(
        standard_client.JointState,
        "joint_states",
        lambda m: heard.update(zip(m.name, zip(m.position, m.velocity, strict=True), strict=True)),
        10,
    )
    killed = monotonic()
    person.until(lambda: len(heard) == 4 and all(abs(v) < 0.01 for _, v in heard.values()), 9.0)
    assert monotonic() - killed < LIVES + 1.0
    assert heard["joint_1"][0] < 0.25  # of 0.3
