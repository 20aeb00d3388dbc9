"""The node of the whole arm, with the nodes of its links and links behind fake transports."""

import os
import re
import signal
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from driver_link import RATE, FakeTransport
from rclpy.action import ActionClient
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from std_srvs.srv import SetBool
from unique_identifier_msgs.msg import UUID

from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.protocol import State
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import LinkCommand

SCRIPTS = Path(__file__).parents[3] / "scripts"


def overrides(**parameters):
    return [Parameter(name, value=value) for name, value in parameters.items()]


class Bench:
    """Two links, their nodes, the arm's node, and a user of it."""

    def __init__(self, spin, file, extrapolate=False):
        self.transports = [FakeTransport(i) for i in (1, 2)]
        links = overrides(rate=RATE, timeout=2.5, arm=str(file))
        self.links = [
            LinkNode(i, transport=transport, parameter_overrides=links)
            for i, transport in enumerate(self.transports, 1)
        ]
        arm = overrides(rate=RATE, arm=str(file), time_to_live=2.5, max_overrun=2.0)
        local = (
            {i: link.on_command for i, link in enumerate(self.links, 1)} if extrapolate else None
        )
        self.arm = ArmNode(local=local, parameter_overrides=arm)
        self.user = Node("user")
        self.mover = ActionClient(self.user, MoveArm, "arm/move")
        self.armer = self.user.create_client(SetBool, "arm/enable")
        self.stopper = self.user.create_publisher(Empty, "arm/stop", 10)
        self.feedback = []
        self.spin = spin
        self.until(lambda: len(self.arm.links.states) == 2 and self.mover.server_is_ready())
        self.until(lambda: self.armer.service_is_ready())
        self.until(lambda: all(client.service_is_ready() for client in self.arm.armers))
        self.until(lambda: self.stopper.get_subscription_count() == 6)

    def until(self, condition, timeout=10.0):
        return self.spin([*self.links, self.arm, self.user], condition, timeout)

    def after(self, future):
        self.until(future.done)
        return future.result()

    def enable(self, data=True):
        for _ in range(3):  # a link that has no time to answer stays as it was
            answer = self.after(self.armer.call_async(SetBool.Request(data=data)))
            if answer.success:
                break
        self.until(lambda: all(link.armed == data for link in self.arm.links.states.values()))
        return answer

    def send_goal(self, *q, duration=0.0, keep_alive=0.0):
        goal = MoveArm.Goal(q=q, duration=duration, keep_alive=keep_alive)
        return self.after(self.mover.send_goal_async(goal, self.feedback.append))

    def end(self, handle):
        return self.after(handle.get_result_async())

    def moving(self, **options):
        """Return a move of both links that is under way."""
        self.enable()
        handle = self.send_goal(0.5, 0.5, duration=20.0, **options)
        self.until(lambda: self.feedback and any(t.link.speed for t in self.transports))
        return handle

    def rest(self):
        self.until(lambda: all(transport.link.speed == 0.0 for transport in self.transports))

    def move(self, *q, **options):
        return self.end(self.send_goal(*q, **options))


@pytest.fixture
def bench(spin, tmp_path, request):
    arm = paper_arm()
    save(replace(arm, links=arm.links[:2]), tmp_path / "arm.yaml")
    bench = Bench(spin, tmp_path / "arm.yaml", getattr(request, "param", False))
    yield bench
    if bench.mover:
        bench.mover.destroy()


def test_all_links_arm_move_together_and_disarm(bench):
    answer = bench.enable()
    assert (answer.success, answer.message) == (True, "all 2 links are armed")
    done = bench.move(0.4, -0.2)
    assert done.status == GoalStatus.STATUS_SUCCEEDED
    assert done.result.reached
    assert list(done.result.q) == pytest.approx([0.4, -0.2], abs=0.005)
    taken = [transport.link.speed for transport in bench.transports]
    assert taken[0] == pytest.approx(2.0 * taken[1], rel=1e-4)
    remaining = [f.feedback.remaining for f in bench.feedback]
    assert len(remaining) > 5
    assert remaining == sorted(remaining, reverse=True)
    assert bench.enable(data=False).success


def test_too_short_a_duration_becomes_what_the_limits_allow_and_is_said(bench, monkeypatch):
    said = []
    monkeypatch.setattr(bench.arm.get_logger(), "info", said.append)
    bench.enable()
    assert bench.move(0.5, 0.0, duration=0.1).result.reached
    lasts = bench.feedback[0].feedback.remaining
    assert lasts > 0.5
    words = f"the move takes {lasts:.2f} s instead of 0.10 s"
    assert said[-1] == f"{words}, as the joints' limits require"


def test_moves_that_make_no_sense_are_rejected(bench, monkeypatch):
    said = []
    monkeypatch.setattr(bench.arm.get_logger(), "warning", said.append)
    bench.enable()
    for q, options, words in (
        ((0.1, 2.0), {}, "q of joint 2 is 114.6 deg, expected -90 to 90 deg"),
        ((0.1, 0.1), {"duration": -1.0}, "duration is -1.0 s, expected 0 to 3600"),
        ((0.1, 0.1), {"keep_alive": -1.0}, "keep_alive is -1.0 s, expected 0 to 3600"),
    ):
        assert not bench.send_goal(*q, **options).accepted
        assert any(line.startswith(f"move rejected: {words}") for line in said)
    assert not any(transport.link.speed for transport in bench.transports)


def test_a_disarmed_arm_does_not_move_and_says_once_what_to_do(bench, monkeypatch):
    said = []
    monkeypatch.setattr(bench.arm.get_logger(), "warning", said.append)
    unarmed = "links 1, 2 are not armed: scripts/fss_arm.sh arm"
    for _ in range(3):
        assert bench.move(0.1, 0.1).result.message == unarmed
    assert said == [f"move aborted: {unarmed}"]
    bench.enable()
    assert bench.move(0.0, 0.0).result.reached
    bench.enable(data=False)
    assert not bench.move(0.1, 0.1).result.reached
    assert len(said) == 2
    assert [transport.link.position for transport in bench.transports] == [0, 0]


def test_links_that_have_not_connected_are_waited_for_without_a_warning(bench, monkeypatch):
    said = []
    monkeypatch.setattr(bench.arm.get_logger(), "info", said.append)
    monkeypatch.setattr(type(bench.arm.links), "unconnected", [1, 2])
    for _ in range(2):
        assert bench.move(0.1, 0.1).result.message == "links 1, 2 are not connected yet"
    assert said == ["moves are refused until the links are ready: links 1, 2 are not connected yet"]


def test_a_second_move_is_refused_and_the_first_can_be_canceled(bench):
    first = bench.moving()
    assert bench.move(0.1, 0.1).result.message == "a move is in progress"
    bench.after(first.cancel_goal_async())
    done = bench.end(first)
    assert done.status == GoalStatus.STATUS_CANCELED
    assert done.result.message == "canceled"
    bench.rest()
    assert bench.arm.links.states[1].armed
    assert bench.move(0.0, 0.0).result.reached


def test_a_move_ends_when_whoever_asked_for_it_is_gone(bench):
    bench.moving()
    bench.mover = bench.mover.destroy()
    bench.until(lambda: not bench.arm.moves.goal_id)
    bench.rest()
    assert all(abs(transport.link.position) < 10_000 for transport in bench.transports)


def test_a_stop_ends_the_move_and_stops_all_links(bench):
    move = bench.moving()
    bench.stopper.publish(Empty())
    done = bench.end(move)
    assert done.result.message == "stopped" or "not armed" in done.result.message
    bench.until(lambda: all(t.link.flags == State.STOPPED for t in bench.transports))
    assert "not armed" in bench.move(0.1, 0.1).result.message
    assert bench.enable().success
    assert bench.move(0.0, 0.0).result.reached


def test_a_lost_link_ends_the_move(bench):
    move = bench.moving()
    bench.transports[1].talks = False
    assert bench.end(move).result.message == "link 2 is silent"
    answer = bench.after(bench.armer.call_async(SetBool.Request(data=True)))
    assert not answer.success
    assert answer.message.startswith("link 2 is lost: silent for")


def test_a_move_that_is_blocked_ends_in_time(bench):
    bench.enable()
    bench.transports[0].hears = False
    move = bench.send_goal(0.2, 0.1)
    message = bench.end(move).result.message
    assert message.startswith("goal not reached within") or "not armed" in message


def test_without_drivers_arming_says_whose_are_missing(spin):
    arm, user = ArmNode(), Node("user")
    armer = user.create_client(SetBool, "arm/enable")
    spin([arm, user], armer.service_is_ready)
    answer = armer.call_async(SetBool.Request(data=True))
    spin([arm, user], answer.done)
    assert answer.result().message == "; ".join(f"link {i} did not answer" for i in (1, 2, 3, 4))


@pytest.mark.parametrize("kind", [ClockType.STEADY_TIME, ClockType.ROS_TIME])
def test_no_timer_keeps_the_systems_clock(ros, kind):
    """A setback would stop such a clock for as long."""
    time = overrides(use_sim_time=kind is ClockType.ROS_TIME)
    link = LinkNode(1, transport=FakeTransport(1), parameter_overrides=time)
    arm = ArmNode(parameter_overrides=time)
    paces = {t.callback: t.clock.clock_type for node in (link, arm) for t in node.timers}
    assert paces[link.send] == paces[arm.tick] == kind
    for node in (link, arm):
        node.close()
        node.destroy_node()


def test_a_move_is_kept_alive_by_whoever_asked_for_it(bench):
    bench.enable()
    alive = bench.user.create_publisher(UUID, "arm/move/alive", 10)
    bench.until(alive.get_subscription_count)
    handle = bench.send_goal(0.2, 0.1, duration=1.5, keep_alive=0.5)
    bench.user.create_timer(0.1, lambda: alive.publish(handle.goal_id))
    assert bench.end(handle).result.reached


def test_a_move_ends_when_whoever_asked_for_it_is_silent(bench):
    """Though it is there, and though another move is kept alive."""
    bench.enable()
    alive = bench.user.create_publisher(UUID, "arm/move/alive", 10)
    bench.user.create_timer(0.1, lambda: alive.publish(UUID()))
    begun = time.monotonic()
    done = bench.move(0.5, 0.5, duration=20.0, keep_alive=0.5)
    assert re.fullmatch(r"its client has been silent for 0\.[5-9] s", done.result.message)
    bench.rest()
    assert time.monotonic() - begun < 1.5
    assert all(transport.link.flags & State.ARMED for transport in bench.transports)


POSTURES = ("--ros-args", "-p", "arm:={}", "-p", "postures:=[1.4, -1.4, -1.4, 1.4]")
slow = partial(pytest.param, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("client", "limit"),
    [
        slow(("fss_arm_calib.experiment.experiment_node", *POSTURES), 1.0),
        (("fss_arm", "move", "80", "-80", "--seconds", "8"), 2.0),
    ],
)
def test_a_move_ends_soon_when_whoever_asked_for_it_is_killed(bench, start, client, limit):
    """Though ROS takes it for alive for 20 s more, and another client is there."""
    bench.enable()
    words = [word.format(bench.arm.settings.arm) for word in client]
    program = start(*words, PYTHONPATH=f"{SCRIPTS}:{os.environ.get('PYTHONPATH', '')}")
    bench.until(lambda: all(abs(t.link.position) > 4000 for t in bench.transports), 40.0)
    program.process.send_signal(signal.SIGKILL)
    killed = time.monotonic()
    bench.rest()
    assert time.monotonic() - killed < limit
    assert not bench.arm.moves.goal_id
    assert bench.arm.count_clients("arm/move/_action/get_result") == 2


def test_after_the_node_stood_still_nothing_old_moves_or_arms(bench):
    move = bench.moving()
    bench.arm.links.stall.last_check -= 5.0  # as after SIGSTOP and SIGCONT
    message = bench.end(move).result.message
    assert re.fullmatch(r"this node paused for 5\.\d s", message)
    bench.rest()
    assert bench.move(0.1, 0.1).result.message == message
    answer = bench.after(bench.armer.call_async(SetBool.Request(data=True)))
    assert (answer.success, answer.message) == (False, message)
    assert bench.after(bench.armer.call_async(SetBool.Request(data=False))).success
    bench.until(lambda: not bench.arm.links.interruption())
    assert bench.enable().success
    assert bench.move(0.1, 0.1).result.reached


def test_a_stop_is_heard_from_any_publisher(bench):
    for reliability in ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT:
        qos = QoSProfile(depth=1, reliability=reliability)
        stop = bench.user.create_publisher(Empty, "arm/stop", qos)
        bench.until(lambda stop=stop: stop.get_subscription_count() >= 3)
        bench.enable()
        stop.publish(Empty())
        bench.until(lambda: all(t.link.flags == State.STOPPED for t in bench.transports))
        bench.user.destroy_publisher(stop)


@pytest.mark.parametrize("bench", [True, slow(False)], indirect=True, ids=["together", "apart"])
def test_moves_and_streams_reach_links_in_one_process_or_in_others(bench):
    told = []
    bench.user.create_subscription(LinkCommand, "link_1/command", told.append, 10)
    bench.until(lambda: bench.arm.count_subscribers("link_1/command") == 2)
    bench.enable()
    assert bench.move(0.1, -0.1).result.reached
    stream = bench.user.create_publisher(JointState, "arm/joint_commands", 1)
    bench.until(stream.get_subscription_count)
    stream.publish(JointState(name=["joint_2"], velocity=[0.2]))
    bench.until(lambda: bench.transports[1].link.taken.mode == LinkCommand.VELOCITY)
    assert bench.transports[0].link.taken.mode != LinkCommand.VELOCITY
    extrapolate = bench.arm.links.commands[1] == bench.links[0].on_command
    assert bool(told) != extrapolate
