"""The topics and actions of the arm's node, its links being ideal."""

import re
import subprocess
import sys
import time
from array import array
from dataclasses import replace
from math import atan2, cos, nan, sin
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from arm_links import ARM, FakeLinks
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from running import wait_until
from scipy.interpolate import CubicSpline
from sensor_msgs.msg import JointState
from standard_client import JOINTS, StandardClient
from std_msgs.msg import Empty, Float64, String
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory

from fss_arm_driver.arm import trajectory_action
from fss_arm_driver.arm.guard_topics import GuardTopics
from fss_arm_driver.arm.request import MAX_POINTS, parse_request
from fss_arm_driver.arm.trajectory import Trajectory
from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.settings import ArmSettings
from fss_arm_model.description_file import to_yaml
from fss_arm_model.guard.guard import GuardError
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.urdf import urdf
from fss_arm_motion.plan import Start, predicted
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import CommandStatus, KinematicCalibration, LinkCommand
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_arm_ros.validation import validators

ENDED = FollowJointTrajectory.Result
THERE = (0.3, -0.2, 0.25, -0.15)
PAGE = (Path(__file__).parents[3] / "docs/how-to/control.md").read_text()
EXAMPLE = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1]


class Bench:
    """Ideal links, the arm's node, and a client that knows standard messages."""

    def __init__(self, spin, **parameters):
        parameters = {"rate": 20.0, "time_to_live": 3.0, "lead": 0.3, **parameters}
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.links, self.client, self.spin = FakeLinks(), StandardClient(), spin
        self.arm = ArmNode(parameter_overrides=overrides)
        self.mover = ActionClient(self.client, MoveArm, "arm/move")
        self.health, self.beats = {}, 0
        self.client.create_subscription(DiagnosticArray, "/diagnostics", self.on_health, 10)
        self.until(lambda: len(self.arm.links.states) == 4 and self.client.ready())
        self.until(lambda: all(p.get_subscription_count() for p in self.links.telemetry))
        self.until(self.mover.server_is_ready)
        paths = self.arm.links.paths.values()
        self.until(lambda: all(p.get_subscription_count() for p in paths))

    def on_health(self, message):
        self.beats += 1
        for status in message.status:
            self.health = {"": status.message} | {v.key: v.value for v in status.values}

    def until(self, condition, timeout=15.0):
        return self.spin([self.links, self.arm, self.client], condition, timeout)

    def after(self, future):
        self.until(future.done)
        return future.result()

    def receive(self, kind, topic, qos=10):
        """Return the list that messages of a topic are added to, once there are any."""
        received = []
        self.client.create_subscription(kind, topic, received.append, qos)
        self.until(lambda: received)
        return received

    def publisher(self, kind, topic, qos=10):
        """Return a publisher that the node receives from."""
        publisher = self.client.create_publisher(kind, topic, qos)
        self.until(publisher.get_subscription_count)
        return publisher

    def send_goal(self, goal):
        handle = self.after(self.client.send(goal))
        assert handle.accepted
        return handle

    def end(self, handle):
        return self.after(handle.get_result_async())

    def execute(self, goal):
        return self.end(self.send_goal(goal))

    def moving(self, seconds=5.0, **tolerances):
        """Return the handle of a goal under way."""
        handle = self.send_goal(self.client.goal([(seconds, THERE)], **tolerances))
        self.until(lambda: self.links.q[0] > 0.02)
        return handle

    def move(self, q):
        """Return the result of the action of moves."""
        return self.end(self.after(self.mover.send_goal_async(MoveArm.Goal(q=q)))).result


@pytest.fixture
def bench(spin, request):
    bench = Bench(spin, **getattr(request, "param", {}))
    yield bench
    bench.client.action.destroy()
    bench.mover.destroy()


def with_parameters(**values):
    return pytest.mark.parametrize("bench", [values], indirect=True)


# --- state ---------------------------------------------------------------------------------------


def test_all_joints_are_in_one_message_at_one_time(bench):
    bench.links.q, begun = list(THERE), bench.links.now()
    bench.until(lambda: bench.client.q and bench.client.near(dict(zip(JOINTS, THERE, strict=True))))
    message = bench.client.states[-1]
    assert message.name == list(JOINTS)
    assert begun < stamp_ns(message.header.stamp) < bench.links.now()
    torque = ARM.links[0].torque_sensor.gain * 400_000
    np.testing.assert_allclose(message.effort, 4 * [torque])
    assert len({stamp_ns(m.header.stamp) for m in bench.client.states}) == len(bench.client.states)


def test_joints_are_extrapolated_but_not_for_long(bench):
    bench.links.silent = {3}
    bench.until(lambda: bench.health.get("arm/joint_states", "").startswith("link 3 was measured"))
    count = len(bench.client.states)
    bench.until(lambda: bench.health[""].startswith("no arm/joint_states: link 3 was measured"))
    assert len(bench.client.states) == count
    bench.links.silent = set()
    bench.until(lambda: len(bench.client.states) > count)


def moving(message):
    return len(message.points) > 1 and max(map(abs, message.points[0].velocities)) > 0.05


def since(message, point):
    return stamp_ns(message.header.stamp) + stamp_ns(point.time_from_start)


@pytest.mark.parametrize("by", ["trajectory", "move"])
def test_what_is_planned_is_told_before_the_joints_do_it(bench, by):
    heard = bench.receive(JointTrajectory, "arm/planned")
    assert [list(p.velocities) for p in heard[-1].points] == [[0.0] * 4]
    if by == "move":
        bench.links.deaf = {1, 2, 3, 4}  # else they would be there at once
        bench.mover.send_goal_async(MoveArm.Goal(q=THERE, duration=3.0))
    else:
        bench.send_goal(bench.client.goal([(1.0, THERE, (0.1, 0.0, 0.0, 0.0)), (3.0, (0.0,) * 4)]))
    bench.until(lambda: moving(heard[-1]))
    early = heard[-1]
    for point in early.points:  # the announced plan is the later plan
        bench.until(lambda p=point: stamp_ns(heard[-1].header.stamp) > since(early, p))
        late = heard[-1]
        ahead = (stamp_ns(late.header.stamp) - since(early, point)) / SECOND
        moved = np.array(point.positions) + ahead * np.array(point.velocities)
        np.testing.assert_allclose(late.points[0].positions, moved, atol=0.02)
    bench.until(lambda: len(heard[-1].points) == 1 and not any(heard[-1].points[0].velocities))


def heading(rotation):
    return 2.0 * atan2(rotation.z, rotation.w)


def test_transforms_lead_from_the_base_to_the_tip_as_the_description_does(bench):
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    found = {}

    def on_transforms(message):
        found.update({t.child_frame_id: t for t in message.transforms})

    bench.client.create_subscription(TFMessage, "/tf", on_transforms, 10)
    bench.client.create_subscription(TFMessage, "/tf_static", on_transforms, latched)
    bench.links.q = list(THERE)
    end = f"link_{ARM.n}"
    bench.until(lambda: {end, "end_effector", "fss_body"} <= found.keys())
    bench.until(
        lambda: abs(heading(found[end].transform.rotation) - ARM.links[-1].theta_0 + 0.15) < 1e-3
    )
    x, y, theta, frame = 0.0, 0.0, 0.0, "end_effector"
    chain = []
    while frame != "fss":
        chain.append(found[frame])
        frame = found[frame].header.frame_id
    for t in reversed(chain):
        p = t.transform.translation
        x, y = x + cos(theta) * p.x - sin(theta) * p.y, y + sin(theta) * p.x + cos(theta) * p.y
        theta += heading(t.transform.rotation)
    expected = tip_pose(ARM.vector(), np.array([0.0, 0.0, 0.0, *THERE]))
    np.testing.assert_allclose([x, y, theta], expected, atol=1e-3)


@with_parameters(publish_tf=False)
def test_without_publish_tf_robot_state_publisher_has_the_transforms(bench):
    assert bench.arm.count_publishers("/tf") == bench.arm.count_publishers("/tf_static") == 0


def test_the_described_base_is_lighter_by_the_propellant_used(bench):
    heard = bench.receive(String, "robot_description", LATCHED)
    left = bench.publisher(Float64, "base/propellant", SENSOR)
    full, masses = bench.arm.settings.full_tank, [ARM.base.mass]
    for grams in ((2.0, 4.0, 30.0), (32.0, 1e6, 60.0)):  # 1 t was never in it
        for used in grams:
            left.publish(Float64(data=full - 1e-3 * used))
        masses.append(ARM.base.mass - (full - (full - 1e-3 * grams[-1])))
        bench.until(lambda: len(heard) == len(masses))
    assert [message.data for message in heard] == [
        urdf(replace(ARM, base=replace(ARM.base, mass=mass))) for mass in masses
    ]


def test_the_description_follows_a_calibration_that_passes(bench):
    heard = bench.receive(String, "robot_description", LATCHED)
    results = bench.publisher(KinematicCalibration, "calibration/kinematic", LATCHED)
    assert heard[-1].data == urdf(ARM)
    better = replace(ARM, theta_E=0.1)
    message = KinematicCalibration()
    message.calibration.verdict, message.calibration.description = "fail", to_yaml(better)
    results.publish(message)
    message.calibration.verdict = "pass"
    results.publish(message)
    bench.until(lambda: len(heard) > 1)
    assert heard[-1].data == urdf(better)
    assert len(heard) == 2
    message.calibration.description = to_yaml(replace(ARM, links=ARM.links[:2]))
    results.publish(message)  # of another arm
    again = replace(ARM, theta_E=0.2)
    message.calibration.description = to_yaml(again)
    results.publish(message)
    bench.until(lambda: heard[-1].data == urdf(again))


# --- streams -------------------------------------------------------------------------------------


@with_parameters(rate=0.5)  # a tick every 2 s
def test_a_stream_is_passed_on_at_once(bench):
    begun = bench.links.now()
    bench.client.command(("joint_4", "joint_2"), effort=(0.4, -0.2))
    bench.until(lambda: len(bench.links.taken) == 2)
    assert all(at - begun < SECOND for at, _, _ in bench.links.taken)
    first, second = bench.links.last(4), bench.links.last(2)
    assert (first.mode, second.mode) == (LinkCommand.CURRENT, LinkCommand.CURRENT)
    assert (first.set_point, second.set_point) == (pytest.approx(0.5), pytest.approx(-0.25))
    assert first.time_to_live == 0.5
    assert stamp_ns(first.header.stamp) >= begun


def test_what_is_refused_moves_nothing_and_is_counted(bench):
    now = bench.client.get_clock().now()
    bench.client.command(stamp=now - Duration(seconds=2.0), position=THERE)
    bench.client.command(stamp=now + Duration(seconds=2.0), position=THERE)
    refused = [f"commands refused: {kind}" for kind in ("old", "future")]
    bench.until(lambda: any(bench.health.get(name) == "1" for name in refused))
    for fields in ({"position": (nan, 0.0, 0.0, 0.0)}, {"position": THERE, "velocity": THERE}):
        refused = bench.arm.streams.stream.refused.total()
        bench.client.command(**fields)
        bench.until(lambda r=refused: bench.arm.streams.stream.refused.total() > r)
    bench.until(lambda: bench.health.get("commands refused: fields") == "1")
    assert bench.health["commands refused: number"] == "1"
    bench.links.armed[1] = False
    bench.until(lambda: not bench.arm.links.states[2].armed)
    bench.client.command(position=THERE)
    bench.until(lambda: bench.health.get("commands refused: links") == "1")
    assert not bench.links.taken
    bench.client.command(("joint_1",), position=(0.1,))  # the others can move
    bench.until(lambda: bench.links.taken)


def test_a_stream_of_a_million_numbers_is_refused_unread(bench):
    (validator,) = [v for v in validators(bench.arm) if v.topic == "arm/joint_commands"]
    message = JointState(name=list(JOINTS), position=array("d", bytes(8_000_000)))
    bench.client.stream.publish(message)
    bench.until(lambda: validator.refused)
    assert re.fullmatch(r"it has 80\d{5} bytes, expected at most 65536", validator.reason)
    assert not bench.links.taken


def test_a_stream_takes_the_turn_of_a_trajectory_and_the_rest_of_the_joints_rest(bench):
    handle = bench.moving()
    bench.client.command(("joint_1",), velocity=(0.1,))
    ended = bench.end(handle)
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert ended.result.error_string == "preempted by arm/joint_commands"
    bench.until(lambda: all(bench.links.last(i).mode == LinkCommand.VELOCITY for i in (1, 2, 3, 4)))
    assert bench.links.last(1).set_point == 0.1
    assert [bench.links.last(i).set_point for i in (2, 3, 4)] == [0.0, 0.0, 0.0]


def test_rates_are_planned_for_as_long_as_their_stream_lives(bench):
    heard = bench.receive(JointTrajectory, "arm/planned")
    bench.client.command(("joint_3",), velocity=(0.1,))
    bench.until(lambda: moving(heard[-1]))
    rates = np.array([point.velocities for point in heard[-1].points])
    np.testing.assert_allclose(rates, np.tile([0.0, 0.0, 0.1, 0.0], (len(rates), 1)))
    told = [point.positions[2] for point in heard[-1].points]
    ahead = [1e-9 * stamp_ns(point.time_from_start) for point in heard[-1].points]
    np.testing.assert_allclose(np.diff(told), 0.1 * np.diff(ahead), atol=1e-12)
    bench.until(lambda: len(heard[-1].points) == 1)
    bench.client.command(("joint_3",), position=(0.0,))
    count, taken = len(heard), len(bench.links.taken)
    bench.until(lambda: len(heard) > count + 2 and len(bench.links.taken) > taken)
    assert len(heard[-1].points) == 1


@with_parameters(stream_time_to_live=2.0)
def test_a_joint_that_left_a_stream_of_rates_starts_again_from_its_measured_rate(bench):
    """Meanwhile it followed its angle or braked, which another joint of the stream does not."""
    streams = bench.arm.streams

    def rates(**fields):
        accepted = streams.stream.accepted
        bench.client.command(**fields)
        bench.until(lambda: streams.stream.accepted > accepted)
        return dict(streams.ramps)

    first = rates(names=("joint_1", "joint_2"), velocity=(0.1, 0.1))
    assert rates(names=("joint_1", "joint_2"), velocity=(0.1, 0.1)) == first
    assert rates(names=("joint_1",), position=(0.0,)) == {2: first[2]}
    until = bench.links.now() + round(streams.time_to_live * SECOND)
    while bench.links.now() <= until:
        rates(names=("joint_3",), velocity=(0.1,))
    again = rates(names=("joint_1", "joint_2"), velocity=(0.1, 0.1))
    assert again[1] is not first[1]
    assert again[2] is not first[2]


def test_a_move_is_refused_while_a_stream_has_the_turn(bench):
    bench.client.command(("joint_1",), velocity=(0.1,))
    bench.until(lambda: bench.links.taken)
    assert bench.move(THERE).message == "arm/joint_commands is in progress"
    bench.until(lambda: not bench.arm.links.arbiter.current_name(bench.arm.links.now()))
    assert bench.move(THERE).reached


# --- trajectories --------------------------------------------------------------------------------


def test_all_links_get_one_path_with_one_begin_and_the_commands_to_follow_it(bench):
    ended = bench.execute(bench.client.goal([(1.0, THERE)]))
    assert (ended.status, ended.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
    paths = [paths[1] for paths in bench.links.paths]
    assert len({(m.path, stamp_ns(m.header.stamp), tuple(m.time)) for m in paths}) == 1
    assert [m.position[-1] for m in paths] == list(THERE)
    assert all(m.velocity[-1] == 0.0 for m in paths)
    commands = [m for _, i, m in bench.links.taken if i == 3]
    assert len(commands) > 3  # one is repeated all the time
    assert {(m.mode, m.path) for m in commands} == {(LinkCommand.PATH, 1)}
    bench.execute(bench.client.goal([(1.0, (0.0, 0.0, 0.0, 0.0))]))
    assert bench.links.last(1).path == 2


def test_a_number_goes_on_after_those_that_links_still_hold(bench):
    bench.links.paths[2][65_535] = None
    bench.until(lambda: bench.arm.links.states[3].path == 65_535)
    bench.client.topic.publish(bench.client.trajectory([(0.8, THERE)]))
    bench.until(lambda: bench.links.taken)
    assert bench.links.last(1).path == 1
    bench.until(lambda: bench.client.near(dict(zip(JOINTS, THERE, strict=True))))


#: What ends a trajectory: the trouble, and the words of the result.
TROUBLES = {
    "joint_2 is off by 0.02 rad, at most 0.01": lambda links: links.off.__setitem__(1, 0.02),
    "link 2 is silent": lambda links: links.silent.add(2),
}


@with_parameters(time_to_live=1.5)
@pytest.mark.parametrize("words", TROUBLES)
def test_a_link_in_trouble_ends_a_trajectory_and_all_come_to_rest(bench, words):
    handle = bench.moving(path=[("joint_2", 0.01)])
    TROUBLES[words](bench.links)
    ended = bench.end(handle).result
    assert ended.error_string.startswith(words)
    bench.until(lambda: all(bench.links.last(i).mode == LinkCommand.VELOCITY for i in (1, 2, 3, 4)))


def test_the_result_gives_the_reason_of_a_link_that_refuses_its_path(bench):
    status = bench.links.create_publisher(CommandStatus, "link_3/command_status", SENSOR)
    bench.until(status.get_subscription_count)
    refusal = CommandStatus(status=CommandStatus.REFUSED, reason="an old command")
    status.publish(refusal)  # stamped before the path
    handle = bench.moving()
    refusal.header.stamp, refusal.reason = to_time(bench.links.now()), "its buffer is full"
    status.publish(refusal)
    ended = bench.end(handle)
    assert ended.result.error_code == ENDED.INVALID_GOAL
    assert ended.result.error_string == "the path is refused by link 3: its buffer is full"


def test_a_stop_or_a_cancel_ends_it_and_a_goal_needs_armed_links(bench):
    stopper = bench.publisher(Empty, "arm/stop")
    handle = bench.moving()
    stopper.publish(Empty())
    ended = bench.end(handle).result
    assert (ended.error_code, ended.error_string) == (ENDED.INVALID_GOAL, "stopped")
    assert bench.links.last(1).mode == LinkCommand.PATH  # its driver stops by itself
    handle = bench.send_goal(bench.client.goal([(20.0, THERE)]))
    bench.until(lambda: bench.links.last(1).path == 2)
    bench.after(handle.cancel_goal_async())
    assert bench.end(handle).status == GoalStatus.STATUS_CANCELED
    bench.until(lambda: bench.links.last(1).mode == LinkCommand.VELOCITY)
    bench.links.armed = 4 * [False]
    bench.until(lambda: not any(link.armed for link in bench.arm.links.states.values()))
    ended = bench.execute(bench.client.goal([(2.0, THERE)])).result
    assert ended.error_code == ENDED.INVALID_GOAL
    assert "not armed: scripts/fss_arm.sh arm" in ended.error_string


def test_oversized_goals_are_rejected_in_one_line(bench, monkeypatch):
    said = []
    monkeypatch.setattr(bench.arm.get_logger(), "warning", said.append)
    goal = bench.client.goal([(1.0, THERE)])
    goal.trajectory.points *= 10_001
    words = "rejected: INVALID_GOAL: points has 10001 elements, expected 1 to 10000"
    assert not bench.after(bench.client.send(goal)).accepted
    assert said == [f"goal {words}"]
    said.clear()
    bench.client.topic.publish(goal.trajectory)
    bench.until(lambda: said)
    assert said == [f"trajectory {words}"]
    assert not bench.links.taken


def test_while_a_goal_is_received_the_node_and_a_motion_continue(bench, monkeypatch):
    """A goal of any size is received in a thread of its own; a stop acts at once."""
    release = Event()

    def slow(*given):
        assert release.wait(30.0)
        return parse_request(*given)

    handle = bench.moving(20.0)
    monkeypatch.setattr(trajectory_action, "parse_request", slow)
    second = bench.client.send(bench.client.goal([(2.0, (0.0, 0.0, 0.0, 0.0))]))
    beats, commands, feedback = bench.beats, len(bench.links.taken), len(bench.client.feedback)
    bench.until(lambda: bench.beats > beats + 3)
    assert len(bench.links.taken) > commands
    assert len(bench.client.feedback) > feedback
    assert handle.status == GoalStatus.STATUS_EXECUTING
    assert not second.done()
    release.set()
    assert bench.after(second).accepted
    assert bench.end(handle).result.error_string == "preempted by a trajectory"
    assert bench.end(second.result()).status == GoalStatus.STATUS_SUCCEEDED


@pytest.mark.slow  # keeps time, so it runs alone
def test_the_longest_goal_runs_and_heartbeats_are_never_older_than_a_second(start, spin):
    settings = "--ros-args", "-p", "time_to_live:=3.0", "-p", "lead:=0.3"
    start("fss_arm_driver.arm_node", *settings, ROS_PYTHON_CHECK_FIELDS="0")
    links, client, beats = FakeLinks(), StandardClient(), []

    def on_health(message):
        if message.status[0].name == "/arm":
            beats.append(1e-9 * stamp_ns(message.header.stamp))

    client.create_subscription(DiagnosticArray, "/diagnostics", on_health, 100)
    times = 2.0 + 0.01 * np.arange(MAX_POINTS)
    waves = np.outer(np.sin(0.3 * (times - 2.0)), THERE)
    goal = client.goal(zip(times.tolist(), waves.tolist(), strict=True))
    nodes = [links, client]
    spin(nodes, lambda: client.ready() and len(beats) > 1, 60.0)
    sent = client.send(goal)
    spin(nodes, sent.done, 60.0)
    assert sent.result().accepted
    ended = sent.result().get_result_async()
    spin(nodes, lambda: ended.done() or links.q[0] > 0.1, 30.0)
    assert not ended.done()
    count = len(beats)
    spin(nodes, lambda: len(beats) > count)
    assert np.diff(beats).max() <= 1.0
    sent.result().cancel_goal_async()
    spin(nodes, ended.done)
    assert ended.result().result.error_string == "canceled"
    client.action.destroy()


def test_a_new_goal_goes_on_from_where_the_old_one_will_be(bench):
    first = bench.send_goal(bench.client.goal([(4.0, THERE)]))
    bench.until(lambda: bench.links.q[0] > 0.1)
    second = bench.send_goal(bench.client.goal([(2.0, (0.0, 0.0, 0.0, 0.0))]))
    assert bench.end(first).result.error_string == "preempted by a trajectory"
    bench.until(lambda: 2 in bench.links.paths[0])
    old, new = (bench.links.paths[0][k] for k in (1, 2))
    t = (stamp_ns(new.header.stamp) - stamp_ns(old.header.stamp)) / SECOND
    s = t / 4.0
    assert new.position[0] == pytest.approx(0.3 * s * s * (3.0 - 2.0 * s))
    assert new.velocity[0] == pytest.approx(0.3 * 6.0 * s * (1.0 - s) / 4.0)
    assert bench.end(second).status == GoalStatus.STATUS_SUCCEEDED


def test_a_topic_is_listened_to_by_best_effort_publishers(bench):
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    bench.publisher(JointState, "arm/joint_commands", qos)


# --- the guard -----------------------------------------------------------------------------------

FOLDED = (0.0, 1.5, 1.5, 1.5)


def test_nothing_folds_the_arm_into_itself_or_the_base(bench):
    ended = bench.execute(bench.client.goal([(9.0, FOLDED)])).result
    assert ended.error_code == ENDED.INVALID_GOAL
    assert re.search(
        r"link \d and \w+.* would be -?0\.\d+ m apart with the joints", ended.error_string
    )
    bench.client.command(position=FOLDED)
    bench.until(lambda: bench.health.get("commands refused: guard") == "1")
    assert "m apart with the joints at" in bench.move(FOLDED).message
    assert not bench.links.taken
    assert bench.health["bodies kept clear of"] == "self"


def odometry(pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0), stamp=None):
    """Odometry of a base with this pose and twist, in the world."""
    message, c, s = Odometry(), cos(pose[2]), sin(pose[2])
    message.header.stamp = to_time(stamp or time.time_ns())
    place, turn, v = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    place.x, place.y, turn.z, turn.w = *map(float, pose[:2]), sin(pose[2] / 2), cos(pose[2] / 2)
    v.linear.x, v.linear.y = c * twist[0] + s * twist[1], c * twist[1] - s * twist[0]
    v.angular.z = float(twist[2])
    return message


def test_a_path_ends_when_the_base_drifts_to_the_edge(bench):
    base = bench.publisher(Odometry, "base/state")
    bench.client.create_timer(0.05, lambda: base.publish(odometry(**state)))
    state = {}
    bench.until(lambda: bench.health.get("bodies kept clear of") == "self, edge")
    handle = bench.moving(8.0)
    state = {"pose": (-1.2, 0.0, 0.0), "twist": (-0.3, 0.0, 0.0)}
    ended = bench.end(handle).result
    assert ended.error_string.startswith("table edge and ")
    bench.until(lambda: bench.links.last(1).mode == LinkCommand.VELOCITY)


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_a_path_under_way_is_judged_from_when_the_base_was_seen(ros, late):
    """A base that gives way to joints turns quickly: what comes late is of another momentum."""
    node = Node("guarding")
    guard = GuardTopics(node, ARM, ArmSettings())
    times = np.array([0.0, 1.0, 2.0, 3.0])
    q = np.array([[0.0] * 4, [0.4, 0.2, 0.2, 0.1], [0.5, -0.2, -0.3, 0.2], [0.0] * 4])
    qd = np.array([[0.0] * 4, [0.5, -0.1, -0.2, 0.1], [-0.3, -0.1, -0.1, 0.0], [0.0] * 4])
    start = Start(ARM, q[0], pose=np.array([0.25, 0.0, -0.3]))
    course = predicted(start, times, q, qd)
    base = CubicSpline(course.times, course.pose)
    gaps = []
    for t in np.linspace(0.4, 2.4, 11):
        now = guard.now()
        stamp = now - round(late * SECOND)
        guard.on_base(odometry(base(t - late), base(t - late, 1), stamp))
        path = Trajectory(now - round(t * SECOND), times, q, qd)
        with pytest.raises(GuardError) as refused:
            guard.check_trajectory(path, now)
        gaps.append(float(re.search(r"would be (\S+) m apart", str(refused.value))[1]))
    np.testing.assert_allclose(gaps, gaps[0], atol=2e-3)  # seen at whatever time, the same motion
    node.destroy_node()


def test_one_process_hosts_the_arm_and_its_links(start, spin):
    settings = "-p", "time_to_live:=2.0", "-p", f"urls:={4 * ['udp://127.0.0.1:9']}"
    program = start("fss_arm_driver.driver_node", "--ros-args", *settings)
    ears = Node("ears")
    names = {"arm", "link_1", "link_2", "link_3", "link_4"}
    spin(ears, lambda: names <= set(ears.get_node_names()), 60.0)
    assert program.stop() == 0


def test_the_joints_rest_soon_after_the_example_of_a_client_is_killed(bench):
    """Though ROS takes it for alive for 20 s more."""
    process = subprocess.Popen([sys.executable, "-c", EXAMPLE])
    try:
        bench.until(lambda: bench.client.q and not bench.client.resting(), 60.0)
    finally:
        process.kill()
        process.wait()
    killed = time.monotonic()
    bench.until(lambda: not bench.arm.links.arbiter.current_name(bench.arm.links.now()))
    assert time.monotonic() - killed < 2.5  # it would last 4 s
    bench.until(bench.client.resting)
    assert not bench.client.near({"joint_1": 0.3})


def test_a_stop_ends_a_motion_though_the_executor_is_busy(bench):
    """The node is not spun meanwhile."""
    stop = bench.publisher(Empty, "arm/stop")
    bench.send_goal(bench.client.goal([(20.0, THERE)]))
    bench.until(lambda: bench.arm.trajectories.motion)
    motion = bench.arm.trajectories.motion
    stop.publish(Empty())
    wait_until(lambda: motion.end_reason, 5.0, lambda: time.sleep(0.01))
    assert motion.end_reason == "stopped"
