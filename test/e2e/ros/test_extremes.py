"""Each field of each goal, plan and command at its extremes, sent to an armed graph at rest.

A message is valid, and asks for rest, but for one field. So whether it is refused or obeyed, no
joint moves. A valve opens only while an accepted goal or reference holds the base where it is, as
one with a number that is almost 0. test_validation.py has the measurements.
"""

from bisect import bisect
from collections import Counter
from math import inf, nan

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from flight import Flyer, start
from geometry_msgs.msg import WrenchStamped
from message_fields import changed, element, fields
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from running import OWN, memory
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fss_arm_msgs.action import ExecuteMotion, FollowPoses, GoToPose, HoldBase, MoveArm
from fss_arm_msgs.msg import LinkCommand, LinkPath, ThrusterCommand
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_gnc import messages
from fss_gnc.reference import Path
from fss_rehearsal.processes import Nodes

DENORMAL, MILLION = 5e-324, 1_000_000
EXTREMES = (nan, inf, -inf, 1e18, -1e18, DENORMAL, -DENORMAL)
#: Numbers that cannot be negative. (A joint may be commanded to -1 rad, but not for -1 s.)
MAGNITUDES = ("duration", "keep_alive", "time", "max_")
MAX_GROWTH = 50.0  # of memory [MB]
GOAL_GROWTH = 150.0  # of a node whose goal rclpy converts as a whole, before it can be refused [MB]
MAX_GAP = 2.0  # between heartbeats: a period of 1 s, and 1 s more [s]
BUSY_GAP = 10.0  # where other tests run beside this one [s]
NAMES = [f"joint_{i}" for i in (1, 2, 3, 4)]
REST = 4 * [0.0]
AT_ORIGIN = Path(np.arange(2.0), np.zeros((2, 3, 3)))


def trajectory(stamp=0):
    """Return a trajectory of the joints at rest."""
    points = [
        JointTrajectoryPoint(positions=REST, velocities=REST, time_from_start=Duration(sec=sec))
        for sec in (1, 2)
    ]
    message = JointTrajectory(joint_names=NAMES, points=points)
    message.header.stamp = to_time(stamp)
    return message


def wrench(now):
    message = WrenchStamped()
    message.header.frame_id, message.header.stamp = "fss", to_time(now)
    return message


def path(now):
    message = LinkPath(path=1, time=[0.0, 1.0], position=2 * [0.0], velocity=2 * [0.0])
    message.header.stamp = to_time(now + SECOND)
    return message


#: Command topics: message at a time [ns] that asks for rest.
COMMANDS = {
    "link_1/command": lambda now: LinkCommand(mode=LinkCommand.POSITION, time_to_live=0.5),
    "link_1/path": path,
    "arm/joint_commands": lambda now: JointState(name=NAMES, position=REST),
    "arm_controller/joint_trajectory": lambda now: trajectory(),
    "arm/planned": trajectory,
    "thrusters/command": lambda now: ThrusterCommand(),
    "base/wrench": wrench,
    "base/trajectory": lambda now: messages.trajectory(AT_ORIGIN, 0.0, now, 1.0, 1.0),
}
#: Actions: kind and goals that ask for rest.
GOALS = {
    "arm/move": (MoveArm, MoveArm.Goal(q=REST, duration=0.5)),
    "arm_controller/follow_joint_trajectory": (
        FollowJointTrajectory,
        FollowJointTrajectory.Goal(trajectory=trajectory()),
    ),
    "arm/execute": (
        ExecuteMotion,
        ExecuteMotion.Goal(kind="point_to_point", arguments=["--goal", *4 * ["0"]]),
    ),
    "base/hold": (HoldBase, HoldBase.Goal(pose=[0.0, 0.0, 0.0], duration=0.5)),
    "base/go_to": (GoToPose, GoToPose.Goal(pose=[0.0, 0.0, 0.0], hold_duration=0.1)),
    "base/follow": (
        FollowPoses,
        FollowPoses.Goal(time=[0.0, 1.0], pose=6 * [0.0], twist=6 * [0.0]),
    ),
}


def extremes(message):
    """Yield (path, value) for the numbers of a message, alone or one in a sequence."""
    for path, value, kind in fields(message):
        negative = [-1.0] if any(m in ".".join(path) for m in MAGNITUDES) else []
        numbers = (*EXTREMES, *negative)
        if kind in ("double", "float"):
            yield from ((path, number) for number in numbers)
        elif kind.startswith(("int", "uint")):
            limits = np.iinfo(kind)
            yield from ((path, int(number)) for number in (limits.min, limits.max))
        elif kind.startswith(("sequence<double", "double[")):
            length = len(value)
            for number in numbers:
                yield from ((path, [*value[:k], number, *value[k + 1 :]]) for k in (0, length - 1))
        if kind.startswith("sequence<"):
            yield path, []
        if kind == "sequence<string>":
            yield path, [*list(value)[:-1], "nan"]
            yield path, [*list(value)[:-1], "1e18"]
        if "/" in kind and kind.startswith("sequence<") and len(value):
            for inner, extreme in extremes(value[0]):
                yield path, [changed(value[0], inner, extreme), *value[1:]]


def long_ones(message):
    """Yield (path, value) for each sequence of a message, with a million elements."""
    for path, value, kind in fields(message):
        if kind.startswith("sequence<"):
            one = value[0] if len(value) else element(kind[9:-1])
            # Points of a trajectory are large: a hundred thousand are tens of megabytes.
            yield path, (MILLION // 10 if "/" in kind else MILLION) * [one]


class Stranger(Flyer):
    """Sends extremes, and watches heartbeats, valves and joints."""

    def __init__(self, nodes):
        super().__init__(nodes)
        self.forget()
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10_000)

    def forget(self):
        """Begin to watch."""
        self.truths.clear()
        self.attacks = [(0.0, "nothing yet")]  # when each began [s]
        self.beats = {}  # stamp of the last heartbeat of each node [s]
        self.longest = {}  # longest time without one [s], and what was attacked at its end
        self.held = []  # begin and end of what may hold the base [s]

    def send_changed(self, changes):
        """Send all commands and goals with each change; return how many there were."""
        sent = sum(self.publish_all(topic, make, changes) for topic, make in COMMANDS.items())
        return sent + sum(self.send_all(name, *of, changes) for name, of in GOALS.items())

    def on_diagnostics(self, message):
        """Measure the time between heartbeats by their stamps: this process itself may be late."""
        now = 1e-9 * stamp_ns(message.header.stamp)
        for status in message.status:
            name = status.name.lstrip("/")
            gap = round(now - self.beats.get(name, now), 2), self.attacks[-1][1]
            self.beats[name], self.longest[name] = now, max(self.longest.get(name, gap), gap)

    def publish_all(self, topic, make, changes):
        """Publish a command with each change."""
        example = make(self.get_clock().now().nanoseconds)
        self.attacks.append((self.t, topic))
        publisher = self.create_publisher(type(example), topic, QoSProfile(depth=5))
        self.until(publisher.get_subscription_count, why=topic)
        sent, since = 0, self.t
        for field, value in changes(example):
            now = self.get_clock().now().nanoseconds
            message = changed(make(now), field, value)
            if hasattr(message, "header") and "stamp" not in field and topic != "link_1/path":
                message.header.stamp = to_time(now)
            publisher.publish(message)
            self.executor_.spin_once(timeout_sec=0.002)
            sent += 1
        self.pass_time(3.0)  # until a reference has expired, and the valves have closed
        if topic == "base/trajectory":
            self.held.append((since, self.t))
        self.destroy_publisher(publisher)
        return sent

    def send_all(self, action, kind, goal, changes):
        """Send a goal with each change; each is refused, or ends."""
        client = ActionClient(self, kind, action)
        self.attacks.append((self.t, action))
        self.until(client.server_is_ready, why=action)
        sent = 0
        for field, value in changes(goal):
            answer = client.send_goal_async(changed(goal, field, value))
            self.until(answer.done, 600.0, f"an answer to {action} with another {field}")
            handle = answer.result()
            sent += 1
            if handle.accepted:
                ended, since = handle.get_result_async(), self.t
                end = since + 3.0
                self.until(lambda ended=ended, end=end: ended.done() or self.t > end)
                if not ended.done():
                    self.after(handle.cancel_goal_async())
                status = self.after(ended).status
                if action.startswith("base/") and status != GoalStatus.STATUS_ABORTED:
                    self.pass_time(1.0)
                    self.held.append((since, self.t))
        client.destroy()
        return sent

    def opened(self):
        """Return what was attacked when a valve was open although nothing held the base."""
        times = [1e-9 * stamp_ns(t.header.stamp) for t in self.truths if any(t.valves)]
        unasked = [t for t in times if not any(a <= t <= b for a, b in self.held)]
        starts = [since for since, _ in self.attacks]
        return Counter(self.attacks[bisect(starts, t) - 1][1] for t in unasked)


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    rclpy.init(args=[])
    with Nodes(tmp_path_factory.mktemp("nodes"), print, OWN) as nodes:
        start(nodes, speed=1.0, testbed={"preset": "ideal"})
        nodes.start("motion", "fss_arm_motion", "motion", use_sim_time=True)
        stranger = Stranger(nodes)
        stranger.begin()
        yield stranger
        stranger.close()
    rclpy.try_shutdown()


def nothing(message):
    """Yield the message as it is, so that each node has done once what it then does again."""
    yield next(fields(message))[:2]


@pytest.mark.slow
@pytest.mark.parametrize(("changes", "max_gap"), [(extremes, BUSY_GAP), (long_ones, MAX_GAP)])
def test_extremes_open_and_move_nothing(stranger, changes, max_gap):
    nodes = stranger.nodes.processes
    stranger.send_changed(nothing)
    before = {name: memory(process.pid) for name, process in nodes.items()}
    stranger.forget()
    sent = stranger.send_changed(changes)
    opened = stranger.opened()
    angle = np.abs([truth.q[3:] for truth in stranger.truths]).max()
    growth = {name: (memory(p.pid) - before[name]) / 1e6 for name, p in nodes.items()}
    print(f"{sent} sent; of {len(stranger.truths)} states, valves were open during {dict(opened)}")
    print(f"joints within {angle:.1e} rad")
    print("longest between heartbeats [s]:", stranger.longest)
    print("growth [MB]:", {name: round(mb, 1) for name, mb in growth.items()})
    assert sent > len(COMMANDS) + len(GOALS)
    assert not opened
    assert angle < 1e-3
    assert all(process.poll() is None for process in nodes.values())
    assert set(stranger.longest) >= {"arm", "base", "control", "guidance", "navigation", "motion"}
    assert max(gap for gap, _ in stranger.longest.values()) < max_gap
    assert growth.pop("arm") < (GOAL_GROWTH if changes is long_ones else MAX_GROWTH)
    assert max(growth.values()) < MAX_GROWTH
