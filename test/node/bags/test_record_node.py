"""The recorder on live topics."""

from contextlib import contextmanager
from resource import RLIMIT_FSIZE, getrlimit, setrlimit

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_bags import joint_state, states
from rosbags.interfaces import QosDurability, QosReliability
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Int64, String

from fss_arm_bags.definitions import definition
from fss_arm_bags.reader import open_bags
from fss_arm_bags.record_node import RecordNode, matching_qos
from fss_arm_ros.diagnostics import ERROR, WARN
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_arm_ros.source_version import source_version

BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


def recorder(output, **values):
    given = {"output": str(output), **values}
    return RecordNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])


def test_every_published_message_is_in_the_bag(spin, tmp_path):
    node = Node("source")
    states_out = node.create_publisher(JointState, "joint_states", SENSOR)
    loose_out = node.create_publisher(Int64, "loose", BEST_EFFORT)
    text_out = node.create_publisher(String, "robot_description", LATCHED)
    hidden = node.create_publisher(Int64, "move/_action/hidden", 10)
    text_out.publish(String(data="arm"))  # long before the recorder starts
    record = recorder(tmp_path)
    outs = (states_out, loose_out, text_out)
    spin([node, record], lambda: all(out.get_subscription_count() for out in outs))
    for k in range(200):
        states_out.publish(joint_state(k))
    loose_out.publish(Int64(data=1))
    spin(record, lambda: record.counts["/joint_states"] == 200 and record.counts["/loose"])
    spin(record, lambda: record.counts["/robot_description"])
    assert hidden.get_subscription_count() == 0
    graph = {
        out.topic_name: str(record.get_publishers_info_by_topic(out.topic_name)[0].topic_type_hash)
        for out in outs
    }
    record.close()
    with open_bags(tmp_path) as bags:
        assert bags.paths == [tmp_path / "bag_0"]
        assert not bags.recovered
        assert {name: bags.topics[name].hash for name in graph} == graph
        assert states(bags.messages()) == list(range(200))
        assert bags.topics["/robot_description"].messages == 1
        assert bags.topics["/robot_description"].qos[0].durability == QosDurability.TRANSIENT_LOCAL
        assert bags.topics["/joint_states"].qos[0].durability == QosDurability.VOLATILE
        assert bags.topics["/loose"].qos[0].reliability == QosReliability.BEST_EFFORT
        assert bags.topics["/joint_states"].hash == definition("sensor_msgs/msg/JointState").hash


def test_a_recorder_of_one_vehicle_skips_other_vehicles(spin, tmp_path):
    node = Node("source")
    topics = ["/fss1/joint_states", "/fss2/joint_states", "/fss22/joint_states", "/joint_states"]
    shared = ["/vicon/fss1/fss1", "/clock", "/sim/faults"]
    outs = [node.create_publisher(Int64, topic, SENSOR) for topic in topics + shared]
    parameters = [Parameter("output", value=str(tmp_path))]
    record = RecordNode(namespace="fss2", parameter_overrides=parameters)
    all_of_them = recorder(tmp_path, namespace="/")
    spin([node, record, all_of_them], lambda: all(out.get_subscription_count() for out in outs))
    named = recorder(tmp_path, namespace="fss1", shared=[""])
    spin([node, named], lambda: outs[0].get_subscription_count() == 2)
    expected = {"/fss2/joint_states", *shared}
    spin(record, lambda: set(record.recording.topics) >= expected)
    recorded = set(record.recording.topics)
    of_ros = ("/rosout", "/parameter_events", "/diagnostics")
    assert {topic for topic in recorded if topic not in of_ros} == expected
    assert set(all_of_them.recording.topics) >= set(topics + shared)
    assert "/fss2/joint_states" not in named.recording.topics


def test_a_selected_topic_is_recorded_alone_and_with_a_later_best_effort_publisher(spin, tmp_path):
    node = Node("source")
    first = node.create_publisher(Int64, "topic", SENSOR)
    other = node.create_publisher(Int64, "other", SENSOR)
    record = recorder(tmp_path, topics=["topic"])
    spin([node, record], first.get_subscription_count)
    second = node.create_publisher(Int64, "topic", BEST_EFFORT)
    spin([node, record], second.get_subscription_count)
    spin([node, record], first.get_subscription_count)
    node.create_timer(0.01, lambda: (first.publish(Int64()), second.publish(Int64())))
    spin([node, record], lambda: record.counts["/topic"] > 2)
    assert set(record.recording.topics) == {"/topic"}
    assert other.get_subscription_count() == 0


def test_simulated_time_is_the_time_of_receipt(spin, tmp_path):
    node = Node("source")
    data, latched, clock = (
        node.create_publisher(Int64, "data", 10),
        node.create_publisher(Int64, "latched", LATCHED),
        node.create_publisher(Clock, "/clock", 1),
    )
    latched.publish(Int64(data=3))
    record = recorder(tmp_path, use_sim_time=True, topics=["data", "latched"])
    got = []
    node.create_subscription(Int64, "data", got.append, 10)
    spin([node, record], lambda: data.get_subscription_count() == 2)
    assert record.health().message == "waiting for /clock"
    data.publish(Int64(data=1))
    spin([node, record], lambda: got and record.early_messages)
    assert not record.counts
    now = Clock()
    now.clock.sec = 100

    def clock_is_set():
        clock.publish(now)
        return record.get_clock().now().nanoseconds

    spin([node, record], clock_is_set)
    data.publish(Int64(data=2))
    spin([node, record], lambda: record.counts["/data"])
    record.close()
    with open_bags(tmp_path) as bags:
        recorded = [(topic, t, m.data) for topic, _, t, m in bags.messages()]
    assert sorted(recorded) == [("/data", 100 * 10**9, 2), ("/latched", 100 * 10**9, 3)]


def test_a_missing_type_is_reported_once(spin, tmp_path, monkeypatch):
    from fss_arm_bags import record_node
    from fss_arm_bags.definitions import NotInstalledError

    requested = []

    def missing(msgtype):
        requested.append(msgtype)
        raise NotInstalledError(f"{msgtype} is not installed")

    monkeypatch.setattr(record_node, "message_class", missing)
    node = Node("source")
    node.create_publisher(Int64, "data", 10)
    record = recorder(tmp_path, topics=["data"])
    spin([node, record], lambda: record.unknown_types == {"/data"})
    record.discover()
    assert requested == ["std_msgs/msg/Int64"]
    assert record.recording.topics == {}


def test_a_subscription_matches_all_publishers():
    assert matching_qos([LATCHED]).durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert matching_qos([LATCHED, SENSOR]).durability == DurabilityPolicy.VOLATILE
    assert matching_qos([SENSOR]).reliability == ReliabilityPolicy.RELIABLE
    assert matching_qos([SENSOR, BEST_EFFORT]).reliability == ReliabilityPolicy.BEST_EFFORT


@pytest.mark.parametrize("output", ["", "file/inside"])
def test_an_invalid_output_is_rejected(ros, tmp_path, output):
    (tmp_path / "file").touch()
    with pytest.raises((ValueError, OSError)):
        recorder(output and tmp_path / output)


@contextmanager
def file_size_limit(size):
    """Limit the size of files [bytes], which simulates a full disk."""
    soft, hard = getrlimit(RLIMIT_FSIZE)
    setrlimit(RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        setrlimit(RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_retried_and_losses_are_counted(spin, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    node = Node("source")
    out = node.create_publisher(JointState, "joint_states", SENSOR)
    record = recorder(tmp_path / "bags", topics=["joint_states"])
    logged = []
    for level in ("error", "warning"):
        monkeypatch.setattr(record.get_logger(), level, logged.append)
    spin([node, record], out.get_subscription_count)
    counts = record.counts

    def publish(first, count):
        for k in range(first, first + count):
            out.publish(joint_state(k))

    publish(0, 100)
    spin(record, lambda: counts["/joint_states"] == 100)
    record.flush()
    with file_size_limit(record.recording._storage.bio.tell() + 1000):
        publish(100, 50)  # these wait
        spin(record, lambda: counts["/joint_states"] == 150)
        spin(record, lambda: record.recording.failure)
        assert record.health().level == ERROR
        publish(150, 30)
        spin(record, lambda: record.recording.lost == 30)
        record.flush()
        assert logged == [f"cannot write {tmp_path / 'bags/bag_0'}: File too large; retrying"]
    spin(record, lambda: not record.recording.failure)
    assert logged[1:] == [f"writing {tmp_path / 'bags/bag_0'} again; 30 messages were lost"]
    publish(180, 20)
    spin(record, lambda: counts["/joint_states"] == 170)
    assert record.health().level == WARN
    assert record.health().values["lost"] == 30
    assert record.health().values["commit"] == source_version()
    record.close()
    with open_bags(tmp_path / "bags", thorough=True) as bags:
        assert states(bags.messages()) == [*range(150), *range(180, 200)]
        assert bags.recovered == bags.unchecked == []


def test_a_full_disk_at_the_end_is_reported(spin, tmp_path):
    node = Node("source")
    out = node.create_publisher(JointState, "joint_states", SENSOR)
    record = recorder(tmp_path, topics=["joint_states"])
    spin([node, record], out.get_subscription_count)
    out.publish(joint_state(0))
    spin(record, lambda: record.counts["/joint_states"])
    with (
        file_size_limit(1),
        pytest.raises(SystemExit, match=r"bag_0: File too large; earlier messages are saved"),
    ):
        record.close()


def test_a_disk_that_is_full_at_the_start_is_named(ros, tmp_path):
    with file_size_limit(0), pytest.raises(OSError, match="File too large") as error:
        recorder(tmp_path / "bags")
    assert error.value.filename == str(tmp_path / "bags")


def test_a_split_into_an_existing_bag_is_reported(ros, tmp_path, monkeypatch):
    record = recorder(tmp_path)
    monkeypatch.setattr("fss_arm_bags.recorder.next_bag", lambda folder: folder / "bag_0")
    record.recording._split()
    assert record.health().message == "cannot write: File exists"
    monkeypatch.undo()
    record.flush()
    assert record.recording.path.name == "bag_1"
    assert record.recording.failure is None
    record.close()
    record.destroy_node()
