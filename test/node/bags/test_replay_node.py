"""The replay to live subscribers."""

import re

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros_bags import (
    FIRST,
    START,
    STEP,
    joint_state,
    make_bag,
    make_before_and_after,
    make_killed_bag,
    number,
)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

from fss_arm_bags.reader import open_bags
from fss_arm_bags.recorder import Recording
from fss_arm_bags.replay_node import ReplayNode
from fss_arm_msgs.msg import KinematicCalibration
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor
from fss_arm_ros.rclpy_compat import RCLError

KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
KEPT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def replay(*bags, **values):
    given = {"discovery": 0.0, "rate": 0.0, **values}
    overrides = [Parameter(k, value=v) for k, v in given.items()]
    return ReplayNode(*map(str, bags), parameter_overrides=overrides)


def exit_code(spin, nodes, timeout=20.0):
    """Spin until the replay exits; return its exit code or reason."""
    with pytest.raises(SystemExit) as end:
        spin(nodes, lambda: False, timeout)
    return end.value.code


@pytest.mark.parametrize("make", [make_bag, make_killed_bag])
def test_nothing_is_lost_or_changed_at_full_speed(spin, tmp_path, make):
    bag, node, got = make(tmp_path, 1000), Node("reader"), []
    node.create_subscription(JointState, "joint_states", got.append, KEEP_ALL, raw=True)
    player = replay(bag, topics=["joint_states"], wait_for=["joint_states"], hold=True)
    assert list(player.players) == ["/joint_states"]
    spin([player, node], lambda: len(got) == 1000, 20.0)
    with open_bags(bag) as bags:
        assert got == [data for _, _, _, data in bags.raw(["/joint_states"])]


def test_late_subscribers_get_latched_topics_and_commands_are_not_played(spin, tmp_path):
    recording = Recording(tmp_path)
    recording.add("/arm/stop", "std_msgs/msg/Empty", [SENSOR])
    recording.add("/calibration/text", "std_msgs/msg/String", [LATCHED])
    recording.write("/arm/stop", START, serialize_message(Empty()))
    for k in range(3):
        data = serialize_message(String(data=f"pass {k}"))
        recording.write("/calibration/text", START + k, data)
    recording.close()
    player = replay(tmp_path, hold=True)
    spin(player, lambda: player.playback.state == "holding")
    node, got = Node("late"), []
    node.create_subscription(
        String, "recorded/calibration/text", lambda m: got.append(m.data), KEPT
    )
    spin([player, node], lambda: len(got) == 3)
    assert got == ["pass 0", "pass 1", "pass 2"]
    assert player.playback.played == 3
    assert player.count_publishers("/arm/stop") == 0
    assert player.count_publishers("/calibration/text") == 0


def test_a_topic_named_twice_waits_for_two_subscribers(spin, tmp_path):
    wait_for = ["joint_states", "/joint_states"]
    player, node = replay(make_bag(tmp_path, 1), wait_for=wait_for, deadline=1.0), Node("only_one")
    node.create_subscription(JointState, "joint_states", print, SENSOR)
    spin([player, node], player.players["/joint_states"].get_subscription_count)
    assert "too few subscribers of /joint_states" in exit_code(spin, [player, node])
    assert player.playback.played == 0


def test_a_later_start_publishes_latched_messages_first(spin, tmp_path):
    recording = Recording(tmp_path)
    recording.add("/robot_description", "std_msgs/msg/String", [LATCHED])
    recording.add("/joint_states", "sensor_msgs/msg/JointState", [SENSOR])
    for k in range(300):
        receipt = START + k * STEP
        if k % 100 == 0:
            text = String(data=f"arm {k // 100}")
            recording.write("/robot_description", receipt, serialize_message(text))
        recording.write("/joint_states", receipt + 1, serialize_message(joint_state(k)))
    recording.close()
    node, texts, numbers, clock = Node("reader"), [], [], []
    node.create_subscription(String, "robot_description", lambda m: texts.append(m.data), KEPT)
    node.create_subscription(Clock, "/clock", lambda m: clock.append(stamp_ns(m.clock)), KEEP_ALL)
    subscribe_sensor(
        node, JointState, "joint_states", lambda m: numbers.append(number(m)), keep_all=True
    )
    wait_for = ["joint_states", "robot_description"]
    player = replay(tmp_path, start=1.5, clock=True, wait_for=wait_for, hold=True)
    # The last step of the clock is at most 10 ms short.
    spin([player, node], lambda: clock and clock[-1] >= START + 298 * STEP, 20.0)
    spin([player, node], lambda: len(texts + numbers) == 152)
    assert texts == ["arm 1", "arm 2"]
    assert numbers == list(range(150, 300))
    assert clock == sorted(clock)
    assert clock[0] >= START + 149 * STEP


def test_another_publisher_stops_the_replay(spin, tmp_path):
    node = Node("link_1")
    node.create_publisher(JointState, "joint_states", SENSOR)
    player = replay(make_bag(tmp_path, 10), discovery=10.0)
    reason = exit_code(spin, [player, node])
    assert reason == "/joint_states is also published by link_1: stop it, or choose other topics"
    assert player.playback.played == 0


def test_another_clock_stops_the_replay(spin, tmp_path):
    node = Node("sim")
    node.create_publisher(Clock, "/clock", 1)
    player = replay(make_bag(tmp_path, 10), clock=True, discovery=10.0)
    reason = exit_code(spin, [player, node])
    assert reason == "/clock is also published by sim: stop it, or set clock:=false"


def test_a_subscriber_without_room_is_reported(spin, tmp_path, monkeypatch):
    player = replay(make_bag(tmp_path, 3), topics=["joint_states"], hold=True)
    slow, publish = player.players["/joint_states"], Publisher.publish

    def refuse(publisher, message):
        if publisher is slow:
            raise RCLError("timeout")
        publish(publisher, message)

    monkeypatch.setattr(Publisher, "publish", refuse)
    spin(player, lambda: player.health().level == DiagnosticStatus.WARN)
    assert re.fullmatch(
        r"waiting 1\.\d s for a subscriber of /joint_states", player.health().message
    )
    monkeypatch.undo()
    spin(player, lambda: player.playback.state == "holding")
    assert (player.health().level, player.playback.played) == (DiagnosticStatus.OK, 3)


def test_names_that_differ_from_the_recorded_ones_are_logged(spin, monkeypatch):
    lines = []
    monkeypatch.setattr(RcutilsLogger, "info", lambda _, text: lines.append(text))
    replay(FIRST)
    assert "/calibration/kinematic as /recorded/calibration/kinematic" in lines[0]
    assert "/joint_states," in lines[0]


def test_messages_of_the_first_version_are_upgraded(spin):
    """The bag is older than fields of its results, which replay gives their defaults."""
    topic = "calibration/kinematic"
    with open_bags(FIRST) as bags:
        ((_, _, _, recorded),) = bags.messages([f"/{topic}"])
    assert not hasattr(recorded, "homings")
    node, got = Node("reader"), []
    node.create_subscription(KinematicCalibration, f"recorded/{topic}", got.append, LATCHED)
    player = replay(FIRST, hold=True)
    spin([player, node], lambda: got)
    assert got[0].calibration.verdict == recorded.calibration.verdict
    assert list(got[0].calibration.values) == list(recorded.calibration.values)
    assert got[0].homings == KinematicCalibration().homings


def test_a_type_in_two_versions_is_not_played(ros, tmp_path):
    player = replay(make_before_and_after(tmp_path))
    assert "/joint_states" in player.players
    assert "/calibration/observations" in player.players
    assert "/calibration/kinematic" not in player.players
