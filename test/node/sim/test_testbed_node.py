"""The test-bed node: rates and stamps of topics, links on UDP, simulated time."""

import socket
from contextlib import closing, suppress
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.protocol import Command, LinkCommandFlag, Mode, Telemetry, decode, encode
from fss_arm_msgs.msg import SimFaults, SimTruth
from fss_arm_msgs.srv import ResetTestbed, StepTime
from fss_arm_ros.convert import PoseError, planar_pose, stamp_ns
from fss_arm_ros.qos import LATCHED, sensor
from fss_sim import testbed_node
from fss_sim.testbed import State

REAL_TIME_TOPICS = {"/diagnostics", "/rosout", "/parameter_events"}

DISARM = Command(
    link=1, flags=0, boot=0, sequence=0, clock=1, expiry=0, mode=Mode.OFF, watchdog=2000,
    set_point=0, velocity=0, acceleration=0,
)  # fmt: skip


def testbed(**settings):
    settings = {"ports": [0, 0, 0, 0], **settings}
    return testbed_node.TestbedNode(
        parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )


testbed.__test__ = False


@pytest.fixture
def listener(ros):
    node = Node("listener")
    node.received = {"base": [], "tip": [], "imu": [], "clock": []}
    for name, kind, topic in (
        ("base", PoseStamped, "vicon/fss/fss"),
        ("tip", PoseStamped, "vicon/end_effector/end_effector"),
        ("imu", Imu, "fog/imu"),
        ("clock", Clock, "/clock"),
    ):
        node.create_subscription(kind, topic, node.received[name].append, sensor())
    return node


def test_vicon_and_gyro_have_100_hz_and_even_stamps(spin, listener):
    bed = testbed(base=[0.5, -0.5, 1.0])
    spin([bed, listener], lambda: len(listener.received["imu"]) >= 100)
    for name in ("base", "tip", "imu"):
        stamps = np.array([stamp_ns(m.header.stamp) for m in listener.received[name]])
        assert set(np.diff(stamps)) == {10_000_000}
    assert abs(stamps[-1] - bed.get_clock().now().nanoseconds) < 1_000_000_000
    np.testing.assert_allclose(
        planar_pose(listener.received["base"][-1].pose), (0.5, -0.5, 1.0), atol=0.01
    )
    imu = listener.received["imu"][-1]
    assert imu.orientation_covariance[0] == imu.linear_acceleration_covariance[0] == -1.0
    assert imu.angular_velocity_covariance[8] > 0.0


def test_its_clock_advances_in_whole_frames_and_never_starts_at_zero(spin, listener):
    bed = testbed(keep_clock=True, speed=10.0)
    spin([bed, listener], lambda: len(listener.received["clock"]) >= 100)
    clocks = [stamp_ns(m.clock) for m in listener.received["clock"]]
    assert clocks[0] > 1_000_000_000
    steps = np.diff(clocks)  # a late subscriber receives only the newest
    assert (steps > 0).all()
    assert (steps % 10_000_000 == 0).all()


@pytest.fixture
def call(spin):
    """call(bed, name, kind, **request): return the response of a service of the test bed."""

    def call_service(bed, name, kind, **request):
        node = Node("client", start_parameter_services=False, enable_rosout=False)
        client = node.create_client(kind, name)
        spin([bed, node], client.service_is_ready)
        answer = client.call_async(kind.Request(**request))
        spin([bed, node], answer.done)
        node.destroy_node()
        return answer.result()

    return call_service


def test_services_pause_step_and_resume_time(spin, listener, call):
    bed = testbed(keep_clock=True)
    spin([bed, listener], lambda: listener.received["clock"])
    assert not call(bed, "sim/step", StepTime, frames=1).success
    assert call(bed, "sim/pause", SetBool, data=True).success
    start_frame = bed.testbed.frame
    answer = call(bed, "sim/step", StepTime, frames=250)
    assert answer.success
    assert stamp_ns(answer.stamp) == 1_000_000_000 + (start_frame + 250) * 10_000_000
    assert bed.testbed.frame == start_frame + 250
    assert not call(bed, "sim/step", StepTime, frames=1_000_000).success
    assert call(bed, "sim/pause", SetBool, data=False).success
    spin([bed, listener], lambda: bed.testbed.frame > start_frame + 260)


def test_ros_time_cannot_be_paused(spin, listener, call):
    bed = testbed()
    for answer in (
        call(bed, "sim/pause", SetBool, data=True),
        call(bed, "sim/step", StepTime, frames=1),
    ):
        assert not answer.success
        assert "start the test bed with -p keep_clock:=true" in answer.message


def test_a_node_started_while_paused_receives_the_time(spin, call):
    bed = testbed(keep_clock=True, paused=True)
    call(bed, "sim/step", StepTime, frames=3)
    late = Node("late", parameter_overrides=[Parameter("use_sim_time", value=True)])
    spin([bed, late], lambda: late.get_clock().now().nanoseconds == 1_030_000_000)


def test_full_speed_waits_only_for_drivers(spin, listener):
    bed = testbed(keep_clock=True, speed=0.0)
    spin([bed], lambda: bed.testbed.frame > 1000)


class Session:
    """Records all outputs of a test bed in a scripted session in stepped time."""

    def __init__(self, bed, call):
        self.bed, self.call = bed, call
        self.topics, self.streams = {}, [[] for _ in bed.wires]
        for publisher in bed.publishers:
            if publisher.topic_name not in REAL_TIME_TOPICS:
                self.record(publisher, self.topics.setdefault(publisher.topic_name, []))
        self.hosts = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in bed.wires]
        for host in self.hosts:
            host.bind(("127.0.0.1", 0))
            host.setblocking(False)

    def record(self, publisher, recorded):
        publish = publisher.publish

        def spy(message):
            recorded.append(message)
            publish(message)

        publisher.publish = spy

    def run(self, seed):
        """Run a session; return the recorded outputs by topic and by link."""
        assert self.call(self.bed, "sim/reset", ResetTestbed, seed=seed).success
        for recorded in (*self.topics.values(), *self.streams):
            recorded.clear()
        boot = self.bed.testbed.boot
        for k, frames in enumerate((30, 1, 69, 50)):
            for i, host in enumerate(self.hosts):
                command = replace(
                    DISARM, link=i + 1, sequence=k + 1, clock=1000 * k + 1, boot=boot if k else 0,
                    flags=LinkCommandFlag.ARM if k else 0, expiry=60_000_000 if k else 0,
                    mode=Mode.POSITION if k else Mode.OFF, set_point=10_000 * k * (i + 1),
                    velocity=300_000, acceleration=3000,
                )  # fmt: skip
                host.sendto(encode(command), ("127.0.0.1", self.bed.wires[i].port))
            assert self.call(self.bed, "sim/step", StepTime, frames=frames).success
            for host, stream in zip(self.hosts, self.streams, strict=True):
                with suppress(BlockingIOError):
                    while True:
                        stream.append(without_boot(host.recv(100)))
        topics = {topic: tuple(recorded) for topic, recorded in self.topics.items()}
        return topics, [tuple(stream) for stream in self.streams]

    def close(self):
        for host in self.hosts:
            host.close()


def without_boot(data):
    """Return a frame without boot number and CRC, the only bytes that differ between starts."""
    return data[:6] + data[8:52] + data[56:]


SCRIPT = """
- {at: 0.1, part: link_1, fault: corruption, value: 0.5}
- {at: 0.1, part: link_1, fault: jitter, value: 0.2}
- {at: 0.2, part: link_2, fault: reordering, value: 0.5}
- {at: 0.2, part: link_2, fault: duplication, value: 0.5}
- {at: 0.5, part: link_3, fault: dead, duration: 0.1}
- {at: 0.5, part: fss, fault: dropout, value: 0.3, duration: 0.5}
- {at: 0.5, part: end_effector, fault: occlusion, value: 0.3}
- {at: 1.0, part: fog, fault: bias, value: 0.01}
"""


MARKERS = {
    "marker_noise": 0.0003, "vicon_edge_error": 0.001, "vicon_occlusion": 1.0,
    "vicon_merge_distance": 0.5, "vicon_merge_swap": 0.5, "vicon_jitter": 0.001,
}  # fmt: skip


@pytest.mark.parametrize("more", [{}, {"wifi": True, **MARKERS}])
def test_the_same_seed_and_script_give_the_same_bytes_in_stepped_time(spin, call, tmp_path, more):
    (tmp_path / "faults.yaml").write_text(SCRIPT)
    bed = testbed(
        keep_clock=True, paused=True, preset="paper", telemetry_rate=20.0,
        faults=str(tmp_path / "faults.yaml"), **more,
    )  # fmt: skip
    with closing(Session(bed, call)) as session:
        topics, streams = session.run(seed=7)
        assert len(topics["/clock"]) == len(topics["/vicon/end_effector/end_effector"]) == 150
        assert len(topics["/vicon/fss/fss"]) < 150
        assert len(topics["/sim/faults"]) == 5  # at each event time of the script
        assert min(map(len, streams)) > 5
        assert abs(bed.testbed.plant.q[3:]).max() > 0.1  # the arm moved
        assert session.run(seed=7) == (topics, streams)
        other = session.run(seed=8)
        assert other[0]["/vicon/fss/fss"] != topics["/vicon/fss/fss"]
        assert other[1][0] != streams[0]


def test_a_link_answers_the_sender_of_a_valid_command(spin, listener):
    bed = testbed()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        host.setblocking(False)
        host.sendto(b"noise", ("127.0.0.1", bed.wires[0].port))
        host.sendto(encode(DISARM), ("127.0.0.1", bed.wires[0].port))

        def answer():
            try:
                return decode(host.recv(100))
            except BlockingIOError:
                return None

        frame = spin([bed], answer)
    assert isinstance(frame, Telemetry)
    assert (frame.link, frame.boot, frame.echo) == (1, bed.testbed.boot, 1)


def test_the_driver_reaches_links_on_terminals(spin, tmp_path):
    paths = [str(tmp_path / f"link_{i}") for i in (1, 2, 3, 4)]
    bed = testbed(terminals=paths, q=[0.0, 0.3, 0.0, 0.0])
    link = LinkNode(2, f"serial://{paths[1]}?baud=115200")
    spin([bed, link], lambda: link.session.frame)
    assert link.session.scale.position(link.session.frame.position) == pytest.approx(0.3, abs=0.01)


def test_drivers_reach_links_over_each_transport(spin, tmp_path):
    paths = [str(tmp_path / f"link_{i}") for i in (1, 2, 3, 4)]
    angles = [0.1, 0.2, 0.3, 0.4]
    bed = testbed(transports=["udp", "tcp", "serial", "tcp"], terminals=paths, q=angles)
    ports = [getattr(wire, "port", 0) for wire in bed.wires]
    urls = [f"udp://127.0.0.1:{ports[0]}?bind=0", f"tcp://127.0.0.1:{ports[1]}",
            f"serial://{paths[2]}", f"tcp://127.0.0.1:{ports[3]}"]  # fmt: skip
    links = [LinkNode(i, url) for i, url in enumerate(urls, 1)]
    spin([bed, *links], lambda: all(link.session.frame for link in links))
    found = [link.session.scale.position(link.session.frame.position) for link in links]
    assert found == pytest.approx(angles, abs=0.01)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"transports": ["tcp", "udp"]}, "transports is .*, expected 1 or 4"),
        ({"transports": ["serial"]}, "terminals has 0 paths, expected 4"),
        ({"transports": ["can"]}, "transports is 'can', expected one of udp, tcp, serial"),
    ],
)
def test_invalid_transports_are_rejected(ros, given, error):
    with pytest.raises(ValueError, match=error):
        testbed(**given)


def test_truth_has_vicons_frame_number_and_marker_counts(spin, listener):
    truths = []
    listener.create_subscription(SimTruth, "sim/truth", truths.append, sensor())
    bed = testbed(marker_noise=0.0003)
    spin([bed, listener], lambda: truths)
    assert truths[0].frame % 10 == 0
    assert truths[0].markers.tolist() == [5, 4, 0]


def test_it_resumes_from_its_state_file(spin, listener, tmp_path):
    path = str(tmp_path / "state.json")
    first = testbed(state_file=path, keep_clock=True, q=[0.1, 0.2, 0.3, 0.4])
    spin([first, listener], lambda: len(listener.received["clock"]) >= 30)
    last = stamp_ns(listener.received["clock"][-1].clock)
    first.close()
    second = testbed(state_file=path, keep_clock=True)
    assert second.testbed.boot == first.testbed.boot % 65535 + 1
    np.testing.assert_allclose(second.testbed.plant.q[3:], [0.1, 0.2, 0.3, 0.4], atol=1e-6)
    assert second.timeline.stamp() > last
    second.close()
    second.destroy_node()


def test_each_boot_number_is_saved_before_it_is_sent_and_none_repeats(spin, call, tmp_path):
    path = tmp_path / "state.json"
    bed, boots = testbed(state_file=str(path), keep_clock=True, paused=True), []

    def keep():
        boots.append(bed.testbed.boot)
        assert State.load(path, 4).boot == boots[-1]  # as if it was killed now

    keep()
    for value in (1.0, 0.0):
        bed.set_parameters([Parameter("link_1.reset", value=value)])
        assert call(bed, "sim/step", StepTime, frames=1).success
    keep()
    assert call(bed, "sim/reset", ResetTestbed, seed=-1).success
    keep()
    assert boots == [(boots[0] + k - 1) % 65535 + 1 for k in range(3)]


def test_an_unwritable_state_is_logged_and_the_ports_are_closed(ros, tmp_path, capfd):
    (tmp_path / "full").write_text("in the way")
    bed = testbed(state_file=str(tmp_path / "full" / "state.json"))
    wires = [wire for vehicle in bed.vehicles for wire in vehicle.all_wires()]
    ports = [int(wire.address.split()[-1]) for wire in wires]
    bed.close()
    assert capfd.readouterr().err.count(f"cannot write {tmp_path}/full/state.json: ") == 1
    bed.destroy_node()
    again = testbed(ports=ports)
    again.close()
    again.destroy_node()


def test_faults_are_set_live_and_published(spin, listener, call):
    bed, recorded = testbed(keep_clock=True, paused=True, **{"link_2.loss": 0.25}), []
    listener.create_subscription(SimFaults, "sim/faults", recorded.append, LATCHED)

    def active_faults():
        return (
            list(zip(recorded[-1].part, recorded[-1].fault, recorded[-1].value, strict=True))
            if recorded
            else []
        )

    spin([bed, listener], lambda: active_faults() == [("link_2", "loss", 0.25)])
    (result,) = bed.set_parameters([Parameter("end_effector.occlusion", value=1)])
    assert result.successful
    spin([bed, listener], lambda: len(active_faults()) == 2)
    assert call(bed, "sim/step", StepTime, frames=3).success
    spin([bed, listener], lambda: len(listener.received["tip"]) == 3)
    pose = listener.received["tip"][-1].pose
    with pytest.raises(PoseError, match="occluded"):
        planar_pose(pose)
    assert call(bed, "sim/reset", ResetTestbed, seed=-1).success
    spin([bed, listener], lambda: len(recorded) >= 3 and len(active_faults()) == 2)  # they stay
    for name, value in (("link_1.loss", 2.0), ("link_1.loss", "much"), ("fog.bias", 9.0)):
        (result,) = bed.set_parameters([Parameter(name, value=value)])
        assert not result.successful
        assert name in result.reason
    bed.set_parameters([Parameter("link_2.loss", value=0.0)])
    spin([bed, listener], lambda: active_faults() == [("end_effector", "occlusion", 1.0)])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"link_5.loss": 0.1}, "no parameter link_5.loss"),
        ({"fss.turn": 7.0}, "fss.turn is 7"),
        ({"torque_rate": 50}, "expected 10 or 80"),
        ({"battery": 0.0}, "battery is 0.0"),
        ({"terminals": ["/tmp/a"]}, "expected 4"),
        ({"preset": "none"}, "preset is 'none'"),
        ({"speed": 5.0}, "without keep_clock"),
        ({"paused": True}, "without keep_clock"),
        ({"speed": 500.0, "keep_clock": True}, "speed is 500"),
        ({"ports": [0, 0]}, "expected 4"),
        ({"q": [0.0]}, "expected 4"),
        ({"seed": -1}, "seed is -1"),
        ({"vicon_latency": 2.0}, "vicon_latency is 2.0 s, expected 0 to 1"),
    ],
)
def test_impossible_settings_are_refused(ros, settings, words):
    with pytest.raises(ValueError, match=words):
        testbed(**settings)


def test_a_port_in_use_is_named(ros):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=f"UDP port {port} of 127.0.0.1"):
            testbed(ports=[port, 0, 0, 0])
