"""Recorder, replay and doctor as processes: killed, out of disk, started again."""

import signal
from collections import Counter
from functools import partial
from itertools import pairwise

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from ros_bags import make_bag, number
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from fss_arm_bags.reader import open_bags
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import SENSOR, subscribe_sensor
from fss_sim.testbed import FRAME
from fss_sim.timeline import FRAMES_PER_CLOCK

RATES = {
    "vicon/fss/fss": (PoseStamped, 100),
    "vicon/end_effector/end_effector": (PoseStamped, 100),
    "fog/imu": (Imu, 100),
    "/clock": (Clock, 100),
    "joint_states": (JointState, 20),
    **{f"link_{i}/telemetry": (LinkTelemetry, 5) for i in range(1, 5)},
}


class TestBed(Node):
    """Publishes what the demo's nodes do, at their rates."""

    __test__ = False

    def __init__(self):
        super().__init__("testbed")
        self.sent = dict.fromkeys(RATES, 0)
        self.told = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self.hear, 10)
        self.outs = {
            name: self.create_publisher(kind, name, SENSOR) for name, (kind, _) in RATES.items()
        }
        for name, (kind, rate) in RATES.items():
            self.create_timer(1.0 / rate, partial(self.send, name, kind))

    def send(self, name, kind):
        self.outs[name].publish(kind())
        self.sent[name] += 1

    def recorded(self, bag):
        """Whether the recorder of `bag` says that it has something of each topic."""
        return self.told.get("bag") == str(bag) and all(
            int(self.told.get(self.resolve_topic_name(name), 0)) for name in RATES
        )

    def hear(self, diagnostics):
        for status in diagnostics.status:
            if status.name == "/record":
                self.told = {v.key: v.value for v in status.values}


def test_a_killed_recorder_loses_at_most_the_last_second_and_the_next_goes_on(
    spin, start, tmp_path
):
    bed, output = TestBed(), tmp_path / "bags"
    for turn in range(2):
        bag = output / f"bag_{turn}"
        record = start("fss_arm_bags.record_node", "--ros-args", "-p", f"output:={output}")
        spin(bed, partial(bed.recorded, bag), 20.0)
        before, begin = dict(bed.sent), bed.get_clock().now().nanoseconds
        spin(bed, lambda b=before: bed.sent["fog/imu"] - b["fog/imu"] > 250, 20.0)
        sent = {name: bed.sent[name] - before[name] for name in RATES}
        record.stop(signal.SIGKILL)
        with open_bags(bag) as bags:
            assert len(bags.recovered) == 1
            kept = Counter(topic for topic, _, receipt, _ in bags.raw() if receipt >= begin)
        for name, (_, rate) in RATES.items():
            got = kept[bed.resolve_topic_name(name)]
            assert got >= sent[name] - rate, f"{name}: {got} of {sent[name]}"
    with open_bags(output) as bags:
        assert [path.name for path in bags.paths] == ["bag_0", "bag_1"]
        receipts = [t for _, _, t, _ in bags.raw()]
    assert receipts == sorted(receipts)


def test_a_recorder_that_is_stopped_for_a_second_loses_nothing(spin, start, tmp_path):
    bed = ("-p", "keep_clock:=true", "-p", "speed:=2.0")
    record = start("fss_arm_bags.record_node", "--ros-args", "-p", f"output:={tmp_path / 'bags'}")
    start("fss_sim.testbed_node", "--ros-args", *bed)
    node, now, heard = Node("operator"), [0], []

    def on_clock(message):
        now[0] = message.clock.sec

    node.create_subscription(Clock, "/clock", on_clock, 1)
    node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)

    def pass_time(seconds):
        then = now[0] + seconds
        spin(node, lambda: now[0] >= then, 20.0)

    def recorded():
        """Return True if the recorder reports messages, and so has caught up."""
        keys = [v.key for m in heard for s in m.status if s.name == "/record" for v in s.values]
        return "/clock" in keys

    spin(node, recorded, 20.0)
    pass_time(3)
    record.process.send_signal(signal.SIGSTOP)
    pass_time(2)  # simulated: one second, 640 messages
    record.process.send_signal(signal.SIGCONT)
    heard.clear()
    pass_time(3)
    spin(node, recorded, 20.0)
    assert record.stop() == 0, record.output
    with open_bags(tmp_path / "bags") as bags:
        clock = [stamp_ns(m.clock) for *_, m in bags.messages({"/clock"})]
        poses = [stamp_ns(m.header.stamp) for *_, m in bags.messages({"/vicon/fss/fss"})]
    assert max(b - a for a, b in pairwise(clock)) <= FRAMES_PER_CLOCK * FRAME
    assert {b - a for a, b in pairwise(poses)} == {FRAME}
    assert poses[-1] - poses[0] > 7 * SECOND


def test_what_a_user_gets_wrong_ends_in_one_line(start):
    programs = [
        start(f"fss_arm_bags.{module}", *args)
        for module, *args in (
            ("record_node",),
            ("replay_node",),
            ("replay_node", "/no/such/bag"),
            ("record_node", "--ros-args", "-p", "output:=/proc/none"),
        )
    ]
    for program in programs:
        assert program.wait() != 0
        assert len(program.output.splitlines()) == 1, program.output


@pytest.mark.parametrize(
    "count", [pytest.param(count, marks=pytest.mark.slow) for count in (6_000, 11_000)]
)
def test_a_reader_that_stalls_loses_nothing_of_a_replay_at_full_speed(spin, start, tmp_path, count):
    """A reader's queue holds 5,000 messages and a writer's as many: one or both are full."""
    bag = make_bag(tmp_path / "bags", count)
    watch, slow, told, got = Node("watch"), Node("slow"), [0], []
    watch.create_subscription(DiagnosticArray, "/diagnostics", partial(played, told), 10)
    subscribe_sensor(
        slow, JointState, "joint_states", lambda m: got.append(number(m)), keep_all=True
    )
    settings = ["-p", "rate:=0", "-p", "wait_for:=[joint_states]"]
    player = start("fss_arm_bags.replay_node", bag, "--ros-args", *settings)
    spin(watch, lambda: told[0] >= count - 1000, 90.0)
    assert got == []
    spin([watch, slow], lambda: len(got) == count, 90.0)
    assert got == list(range(count))
    spin(slow, lambda: player.process.poll() is not None)
    assert player.process.returncode == 0


def played(told, diagnostics):
    """Keep how far the replay says it is."""
    for status in diagnostics.status:
        if status.name == "/replay":
            told[0] = int({v.key: v.value for v in status.values}["played"])
