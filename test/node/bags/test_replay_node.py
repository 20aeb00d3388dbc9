"""The replay to live subscribers."""

import time

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
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
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor


def replay(*bags, **values):
    given = {"discovery": 0.0, **values}
    overrides = [Parameter(k, value=v) for k, v in given.items()]
    return ReplayNode(*map(str, bags), parameter_overrides=overrides)


def exit_code(spin, nodes, timeout=20.0):
    """Spin until the replay exits; return its exit code or reason."""
    with pytest.raises(SystemExit) as end:
        spin(nodes, lambda: False, timeout)
    return end.value.code


@pytest.mark.parametrize("make", [make_bag, make_killed_bag])
def test_nothing_is_lost_at_full_speed(spin, tmp_path, make):
    node, got = Node("reader"), []
    subscribe_sensor(
        node, JointState, "joint_states", lambda m: got.append(number(m)), keep_all=True
    )
    player = replay(make(tmp_path, 1000), rate=0.0, wait_for=["joint_states"])
    assert exit_code(spin, [player, node]) == 0
    spin(node, lambda: len(got) == 1000)
    assert got == list(range(1000))


def test_messages_are_played_unchanged_at_their_pace(spin, tmp_path):
    bag = make_bag(tmp_path, 50)
    node, got, times = Node("reader"), [], []

    def receive(data):
        got.append(data)
        times.append(time.monotonic())

    node.create_subscription(JointState, "joint_states", receive, SENSOR, raw=True)
    player = replay(bag, rate=2.0, wait_for=["joint_states"])
    assert exit_code(spin, [player, node]) == 0
    spin(node, lambda: len(got) == 50)
    with open_bags(bag) as bags:
        assert got == [data for _, _, _, data in bags.raw(["/joint_states"])]
    assert 0.24 < times[-1] - times[0] < 1.0  # 0.245 s, and what a busy machine adds


def test_the_pause_between_two_sessions_is_skipped(spin, tmp_path):
    hour = 360_000  # messages
    make_bag(tmp_path, 10)
    make_bag(tmp_path, 30, first=hour)
    node, got, times = Node("reader"), [], []

    def receive(message):
        got.append(number(message))
        times.append(time.monotonic())

    subscribe_sensor(node, JointState, "joint_states", receive, keep_all=True)
    player = replay(tmp_path, wait_for=["joint_states"])
    assert exit_code(spin, [player, node]) == 0
    spin(node, lambda: len(got) == 40)
    assert got == [*range(10), *range(hour, hour + 30)]
    assert times[-1] - times[10] > 0.1  # at its pace again: 0.29 s


def test_late_subscribers_get_latched_topics(spin, tmp_path):
    recording = Recording(tmp_path)
    recording.add("/robot_description", "std_msgs/msg/String", [LATCHED])
    for k in range(3):
        recording.write("/robot_description", START + k, serialize_message(String(data=f"arm {k}")))
    recording.close()
    player = replay(tmp_path, rate=0.0, hold=True)
    spin(player, lambda: player.playback.state == "holding")
    node, got = Node("late"), []
    everything = player.players["/robot_description"]
    node.create_subscription(
        String,
        "robot_description",
        lambda m: got.append(m.data),
        QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    spin([player, node], lambda: len(got) == 3)
    assert got == ["arm 0", "arm 1", "arm 2"]
    assert everything.get_subscription_count() == 1


def test_clock_follows_the_times_of_receipt(spin, tmp_path):
    node, got = Node("reader"), []
    node.create_subscription(
        Clock, "/clock", lambda m: got.append(m.clock.sec * 10**9 + m.clock.nanosec), 100
    )
    player = replay(make_bag(tmp_path, 50), rate=2.0, clock=True)
    spin([player, node], player.clock.get_subscription_count)
    exit_code(spin, [player, node])
    spin(
        node, lambda: got and got[-1] >= START + 48 * 10**7
    )  # the last step is at most 10 ms short
    assert got == sorted(got)
    assert got[0] >= START


def test_commands_are_not_played(spin, tmp_path):
    recording = Recording(tmp_path)
    recording.add("/arm/stop", "std_msgs/msg/Empty", [SENSOR])
    recording.add("/calibration/text", "std_msgs/msg/String", [LATCHED])
    recording.write("/arm/stop", START, serialize_message(Empty()))
    recording.write("/calibration/text", START, serialize_message(String(data="pass")))
    recording.close()
    player = replay(tmp_path, rate=0.0, hold=True)
    spin(player, lambda: player.playback.state == "holding")
    assert player.playback.played == 1
    assert player.count_publishers("/arm/stop") == 0
    assert player.count_publishers("/calibration/text") == 0
    assert player.count_publishers("/recorded/calibration/text") == 1


def test_missing_subscribers_are_reported(spin, tmp_path):
    player = replay(make_bag(tmp_path, 1), wait_for=["joint_states"], deadline=0.2)
    assert "too few subscribers of /joint_states" in exit_code(spin, [player])


def test_a_topic_named_twice_waits_for_two_subscribers(spin, tmp_path):
    bag, wait_for = make_bag(tmp_path, 100), ["joint_states", "/joint_states"]
    player = replay(bag, rate=0.0, wait_for=wait_for, deadline=60.0)
    received = {"early": [], "late": []}

    def subscribe(name):
        node = Node(name)
        subscribe_sensor(node, JointState, "joint_states", received[name].append, keep_all=True)
        return node

    early, publisher, ticks = subscribe("early"), player.players["/joint_states"], []
    spin([player, early], publisher.get_subscription_count)
    player.steps = map(ticks.append, player.steps)
    spin([player, early], lambda: len(ticks) > 20)
    assert player.playback.played == 0
    late = subscribe("late")
    assert exit_code(spin, [player, early, late]) == 0
    spin([early, late], lambda: all(len(got) == 100 for got in received.values()))
    for got in received.values():
        assert [number(message) for message in got] == list(range(100))


def test_waiting_for_an_unplayed_topic_is_reported(spin, tmp_path):
    player = replay(make_bag(tmp_path, 1), wait_for=["joint_sates"])
    assert "/joint_sates is not played" in exit_code(spin, [player])


def latched_and_volatile(folder):
    """Make a bag of 3 s with a latched text every second and joint states."""
    recording = Recording(folder)
    recording.add("/robot_description", "std_msgs/msg/String", [LATCHED])
    recording.add("/joint_states", "sensor_msgs/msg/JointState", [SENSOR])
    for k in range(300):
        receipt = START + k * STEP
        if k % 100 == 0:
            text = String(data=f"arm {k // 100}")
            recording.write("/robot_description", receipt, serialize_message(text))
        recording.write("/joint_states", receipt + 1, serialize_message(joint_state(k)))
    recording.close()
    return folder


def test_a_later_start_publishes_latched_messages_first(spin, tmp_path):
    node, got = Node("reader"), []
    keep = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(String, "robot_description", lambda m: got.append(m.data), keep)
    subscribe_sensor(
        node, JointState, "joint_states", lambda m: got.append(number(m)), keep_all=True
    )
    wait_for = ["joint_states", "robot_description"]
    player = replay(latched_and_volatile(tmp_path), rate=0.0, start=1.5, wait_for=wait_for)
    assert exit_code(spin, [player, node]) == 0
    spin(node, lambda: len(got) == 152)
    assert [m for m in got if isinstance(m, str)] == ["arm 1", "arm 2"]
    assert [m for m in got if isinstance(m, int)] == list(range(150, 300))


def test_a_loop_repeats_from_the_start(spin, tmp_path):
    node, got = Node("reader"), []
    subscribe_sensor(
        node, JointState, "joint_states", lambda m: got.append(number(m)), keep_all=True
    )
    bag = latched_and_volatile(tmp_path)
    player = replay(
        bag, rate=0.0, start=2.9, loop=True, topics=["joint_states"], wait_for=["joint_states"]
    )
    spin([player, node], lambda: len(got) >= 25)
    assert got[:25] == [*range(290, 300), *range(290, 300), *range(290, 295)]
    assert list(player.players) == ["/joint_states"]


def test_a_start_after_the_end_is_rejected(ros, tmp_path):
    with pytest.raises(ValueError, match=r"start is 9\.0 s, but the bags last only 2\.990 s"):
        replay(latched_and_volatile(tmp_path), start=9.0)


def test_another_publisher_stops_the_replay(spin, tmp_path):
    node = Node("link_1")
    node.create_publisher(JointState, "joint_states", SENSOR)
    player = replay(make_bag(tmp_path, 10), discovery=10.0)
    reason = exit_code(spin, [player, node])
    assert reason == "/joint_states is also published by link_1: stop it, or choose other topics"
    assert player.playback.played == 0


def test_messages_of_the_first_version_are_upgraded(spin, tmp_path):
    """The bag is older than fields of its results, which replay gives their defaults."""
    topic = "calibration/kinematic"
    with open_bags(FIRST) as bags:
        ((_, _, _, recorded),) = bags.messages([f"/{topic}"])
    assert not hasattr(recorded, "homings")
    node, got = Node("reader"), []
    node.create_subscription(KinematicCalibration, f"recorded/{topic}", got.append, LATCHED)
    player = replay(FIRST, rate=0.0, hold=True)
    spin([player, node], lambda: got)
    assert got[0].calibration.verdict == recorded.calibration.verdict
    assert list(got[0].calibration.values) == list(recorded.calibration.values)
    assert got[0].homings == KinematicCalibration().homings


def test_a_type_in_two_versions_is_not_played(ros, tmp_path):
    player = replay(make_before_and_after(tmp_path))
    assert "/joint_states" in player.players
    assert "/calibration/observations" in player.players
    assert "/calibration/kinematic" not in player.players
