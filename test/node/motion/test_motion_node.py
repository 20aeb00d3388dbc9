"""The node that plans motions, without the arm's node: planning, bounds, cancelling."""

from math import nan
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fss_arm_driver.arm.move import MAX_DURATION as ARM_MAX_DURATION
from fss_arm_driver.arm.request import MAX_POINTS as ARM_MAX_POINTS
from fss_arm_motion import messages
from fss_arm_motion.messages import MAX_CHARACTERS, MAX_DURATION, MAX_POINTS, too_long
from fss_arm_motion.motion_node import MotionNode
from fss_arm_msgs.action import ExecuteMotion
from fss_arm_ros.qos import SENSOR

NO_ARM = "no node offers arm_controller/follow_joint_trajectory: start the node arm"


class Bench:
    """An arm at rest as topics alone, the node, and a user of it."""

    def __init__(self, spin):
        self.motion, self.user, self.spin, self.beats = MotionNode(), Node("user"), spin, 0
        self.states = self.user.create_publisher(JointState, "arm/joint_states", SENSOR)
        self.user.create_timer(0.05, self.report)
        self.user.create_subscription(DiagnosticArray, "/diagnostics", self.on_health, 10)
        self.client = ActionClient(self.user, ExecuteMotion, "arm/execute")
        self.until(lambda: self.client.server_is_ready() and self.motion.measured.t)

    def report(self):
        zeros = [0.0] * 4
        names = [f"joint_{i}" for i in (1, 2, 3, 4)]
        message = JointState(name=names, position=zeros, velocity=zeros, effort=zeros)
        message.header.stamp = self.user.get_clock().now().to_msg()
        self.states.publish(message)

    def on_health(self, _):
        self.beats += 1

    def until(self, condition, timeout=120.0):  # kernels may have to be compiled
        return self.spin([self.motion, self.user], condition, timeout)

    def after(self, future):
        self.until(future.done)
        return future.result()

    def send(self, **goal):
        return self.after(self.client.send_goal_async(ExecuteMotion.Goal(**goal)))

    def execute(self, **goal):
        return self.after(self.send(**goal).get_result_async())


@pytest.fixture
def bench(spin):
    bench = Bench(spin)
    yield bench
    bench.client.destroy()


@pytest.fixture
def slow_planner(monkeypatch):
    """A kind of plan that fails once it is released."""
    release = Event()

    def plan(*_):
        assert release.wait(30.0)
        raise ValueError("there is no plan")

    monkeypatch.setattr(messages, "options_of", lambda *_: (SimpleNamespace(plan=plan), None))
    yield release
    release.set()


def test_the_node_does_not_wait_for_a_plan(bench, slow_planner):
    handle = bench.send(kind="slow")
    bench.until(lambda: bench.motion.busy)
    beats, heard = bench.beats, bench.motion.measured.t
    bench.until(lambda: bench.beats > beats + 3)
    assert bench.motion.measured.t > heard
    assert handle.status == GoalStatus.STATUS_EXECUTING
    ended = handle.get_result_async()
    slow_planner.set()
    assert bench.after(ended).result.message == "there is no plan"


def test_a_goal_is_canceled_while_it_is_planned(bench, slow_planner):
    handle = bench.send(kind="slow")
    bench.until(lambda: bench.motion.busy)
    bench.after(handle.cancel_goal_async())
    ended = bench.after(handle.get_result_async())
    assert (ended.status, ended.result.message) == (GoalStatus.STATUS_CANCELED, "canceled")


TURN = ["--goal", "10", "0", "0", "0"]


def test_oversized_goals_are_rejected_in_one_line(bench, monkeypatch):
    said = []
    monkeypatch.setattr(bench.motion.get_logger(), "warning", said.append)
    turn = {"kind": "point_to_point"}
    for goal, words in (
        ({**turn, "arguments": ["1"] * 1_000_000}, "arguments has 1000000 words, expected at most"),
        ({**turn, "arguments": ["1" * 20_006]}, "arguments has 20006 characters, expected at most"),
        ({"kind": "x" * 20_000}, "kind has 20000 characters, expected at most 10000"),
        ({"file": "x" * 20_000}, "file has 20000 characters, expected at most 10000"),
    ):
        assert not bench.send(**goal).accepted
        assert said.pop().startswith(f"goal rejected: {words}")
        assert not said


def test_impossible_goals_are_refused_with_the_reason(bench):
    turn = {"kind": "point_to_point"}
    for goal, words in (
        ({}, "the goal must have either a kind or a file"),
        ({"kind": "dance"}, "invalid choice: 'dance'"),
        ({"kind": "reorientation", "arguments": ["--speed"]}, "unrecognized arguments: --speed"),
        ({**turn, "arguments": ["--goal", "nan", "0", "0", "0"]}, "nan"),
        ({**turn, "arguments": ["--goal", "120", "0", "0", "0"]}, "joint 1"),
        ({**turn, "arguments": [*TURN, "--duration", "inf"]}, "inf"),
        ({"file": "/none/none.yaml"}, "No such file"),
    ):
        ended = bench.execute(**goal)
        assert ended.status == GoalStatus.STATUS_ABORTED
        assert words in ended.result.message
        assert len(ended.result.message) < MAX_CHARACTERS


def test_plans_longer_than_an_hour_are_refused(bench):
    ended = bench.execute(kind="point_to_point", arguments=[*TURN, "--duration", "1e9"])
    words = "the plan takes 1e+09 s, expected at most 3600"
    assert (ended.status, ended.result.message) == (GoalStatus.STATUS_ABORTED, words)
    # The next goal is planned as usual.
    assert bench.execute(kind="point_to_point", arguments=TURN).result.message == NO_ARM


def test_plans_are_bounded_as_the_arms_node_does():
    assert (MAX_POINTS, MAX_DURATION) == (ARM_MAX_POINTS, ARM_MAX_DURATION)
    times = np.linspace(0.0, MAX_DURATION, MAX_POINTS)
    plan = SimpleNamespace(times=times, duration=MAX_DURATION)
    assert too_long(plan) == ""
    plan.times = np.linspace(0.0, MAX_DURATION, MAX_POINTS + 1)
    assert too_long(plan) == "the plan has 10001 points, expected at most 10000"
    plan.duration = nan
    assert too_long(plan) != ""
