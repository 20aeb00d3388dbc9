"""A program that knows standard messages alone drives the simulated arm, by each standard way."""

import ast
import signal
from itertools import chain, repeat
from pathlib import Path
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


def test_the_client_knows_nothing_of_this_workspace():
    names = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name).split(".")[0]
        for node in ast.walk(ast.parse(Path(standard_client.__file__).read_text()))
        if isinstance(node, (ast.Import, ast.ImportFrom))
    }
    assert names == {"control_msgs", "rclpy", "sensor_msgs", "trajectory_msgs"}


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


def rejected(client):
    """Goals that a joint trajectory controller rejects, by what is wrong."""
    good = [(1.0, THERE)]
    yield "unknown joint", client.goal(good, names=("joint_1", "joint_2", "joint_3", "elbow"))
    yield "partial", client.goal([(1.0, THERE[:2])], names=JOINTS[:2])
    yield "twice", client.goal(good, names=("joint_1", "joint_2", "joint_3", "joint_3"))
    yield "empty", client.goal([])
    yield "no names", client.goal(good, names=())
    yield "sizes", client.goal([(1.0, THERE[:3])])
    yield "times", client.goal([(1.0, THERE), (1.0, HOME)])
    yield "end velocity", client.goal([(1.0, THERE, THERE)])
    yield "past", client.goal(good, stamp=stamped(client, -5.0))
    yield "not a number", client.goal([(1.0, (float("nan"), *THERE[1:]))])


def test_goals_that_make_no_sense_are_rejected(person):
    client = person.client
    for what, goal in rejected(client):
        assert not person.after(client.send(goal)).accepted, what
    assert client.near(dict.fromkeys(JOINTS, 0.0))


def test_goals_that_the_arm_cannot_do_are_aborted_with_the_reason(person):
    client = person.client
    ended = person.go(client.goal([(0.1, THERE)])).result
    assert ended.error_code == ENDED.INVALID_GOAL
    assert "rad/s, expected at most 1" in ended.error_string
    ended = person.go(client.goal([(9.0, (1.6, *THERE[1:]))])).result
    assert ended.error_code == ENDED.INVALID_GOAL
    assert ended.error_string == "joint_1 would be at 1.6000 rad, expected -1.5708 to 1.5708"
    person.enable(False)
    person.until(lambda: client.resting())
    ended = person.go(client.goal([(2.0, THERE)])).result
    assert ended.error_code == ENDED.INVALID_GOAL
    assert "not armed: scripts/fss_arm.sh arm" in ended.error_string


def test_tolerances_on_the_way_and_at_the_goal_are_kept(person):
    client = person.client
    ended = person.go(client.goal([(2.0, THERE)], path=[("joint_3", 1e-5)]))
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert ended.result.error_code == ENDED.PATH_TOLERANCE_VIOLATED
    assert ended.result.error_string.startswith("joint_3 is off by 0.")
    person.until(client.resting)
    ended = person.go(client.goal([(2.0, THERE)], end=[("joint_2", 1e-6)], time=0.3))
    assert ended.result.error_code == ENDED.GOAL_TOLERANCE_VIOLATED
    assert ended.result.error_string.startswith("joint_2 is off by 0.")
    ended = person.go(client.goal([(2.0, HOME)], end=[(j, -1.0) for j in JOINTS]))
    assert ended.result.error_code == ENDED.SUCCESSFUL


def test_a_cancelled_goal_comes_to_rest_and_a_new_one_takes_the_place_of_another(person):
    client = person.client
    handle = person.after(client.send(client.goal([(4.0, THERE)])))
    person.until(lambda: client.q["joint_1"] > 0.05)
    person.after(handle.cancel_goal_async())
    ended = person.after(handle.get_result_async())
    assert ended.status == GoalStatus.STATUS_CANCELED
    person.until(client.resting)
    assert 0.05 < client.q["joint_1"] < 0.2
    first = person.after(client.send(client.goal([(4.0, THERE)])))
    person.until(lambda: client.q["joint_1"] > 0.15)
    second = person.after(client.send(client.goal([(2.0, HOME)])))
    ended = person.after(first.get_result_async())
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert ended.result.error_string == "preempted by a trajectory"
    ended = person.after(second.get_result_async())
    assert ended.status == GoalStatus.STATUS_SUCCEEDED


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
        standard_client.JointState, "joint_states",
        lambda m: heard.update(zip(m.name, zip(m.position, m.velocity, strict=True), strict=True)),
        10,
    )  # fmt: skip
    killed = monotonic()
    person.until(lambda: len(heard) == 4 and all(abs(v) < 0.01 for _, v in heard.values()), 9.0)
    assert monotonic() - killed < LIVES + 1.0
    assert heard["joint_1"][0] < 0.25  # of 0.3
