"""The test-bed node: rates and stamps of topics, links on UDP, simulated time."""

import itertools
import socket
import sys

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool, Header
from std_srvs.srv import SetBool, Trigger

from fss_arm_driver.link_node import LinkNode
from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import GripperState, SimFaults, SimTruth, ThrusterCommand
from fss_arm_msgs.srv import ResetTestbed, StepTime
from fss_arm_ros.convert import PoseError, planar_pose, pose_stamped, stamp_ns, to_time
from fss_arm_ros.lockstep import QOS, REACHED_TOPIC
from fss_arm_ros.qos import COMMAND, LATCHED, sensor
from fss_sim import testbed_node
from fss_sim.messages import SerializedClock, SerializedGyro, SerializedPose
from fss_sim.pace import NODE_LEAD
from fss_sim.sensors import SubjectReading
from fss_sim.testbed import State

REAL_TIME_TOPICS = {"/diagnostics", "/rosout", "/parameter_events"}


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


def test_vicon_and_gyro_have_100_hz_and_even_stamps_and_truth_has_frames_and_markers(
    spin, listener
):
    bed, truths = testbed(base=[0.5, -0.5, 1.0], marker_noise=0.0003), []
    listener.create_subscription(SimTruth, "sim/truth", truths.append, sensor())
    spin([bed, listener], lambda: truths and len(listener.received["imu"]) >= 100)
    assert truths[0].frame % 10 == 0
    assert truths[0].markers.tolist() == [5, 4, 0]
    for name in ("base", "tip", "imu"):
        stamps = np.array([stamp_ns(m.header.stamp) for m in listener.received[name]])
        assert set(np.diff(stamps)) == {10_000_000}
    late = 10_000_000_000  # on a busy computer [ns]
    assert abs(stamps[-1] - bed.get_clock().now().nanoseconds) < late
    np.testing.assert_allclose(
        planar_pose(listener.received["base"][-1].pose), (0.5, -0.5, 1.0), atol=0.01
    )
    imu = listener.received["imu"][-1]
    assert imu.orientation_covariance[0] == imu.linear_acceleration_covariance[0] == -1.0
    assert imu.angular_velocity_covariance[8] > 0.0


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
    bed = testbed(keep_clock=True, speed=10.0)
    spin([bed, listener], lambda: len(listener.received["clock"]) >= 50)
    clocks = [stamp_ns(m.clock) for m in listener.received["clock"]]
    assert clocks[0] > 1_000_000_000
    steps = np.diff(clocks)  # a late subscriber receives only the newest
    assert (steps > 0).all()
    assert (steps % 10_000_000 == 0).all()
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


def test_in_lockstep_time_waits_for_each_node_until_it_ends(spin, call):
    bed = testbed(keep_clock=True, speed=10.0, lockstep=True, paused=True)
    slow = Node("slow")
    reports = slow.create_publisher(Header, REACHED_TOPIC, QOS)

    def report(frame):
        stamp = to_time(1_000_000_000 + frame * 10_000_000)
        reports.publish(Header(stamp=stamp, frame_id="/slow"))
        return bed.timeline.nodes.slowest() == ("/slow", frame + NODE_LEAD)

    spin([bed, slow], lambda: report(0))
    assert call(bed, "sim/pause", SetBool, data=False).success
    for reached in (0, 5, 30):
        spin([bed, slow], lambda reached=reached: report(reached))
        spin([bed, slow], lambda reached=reached: bed.frame == reached + NODE_LEAD)
        with bed.lock:
            bed.timeline.tick()
            assert bed.frame == reached + NODE_LEAD
        assert bed.health().values["slowest node"] == "/slow"
    slow.destroy_publisher(reports)
    spin([bed, slow], lambda: bed.frame > 100)


def test_reports_of_many_nodes_at_once_are_all_received(spin):
    """Two vehicles have some 25 nodes; a lost report would stop the time for 10 s."""
    bed = testbed(keep_clock=True, lockstep=True, paused=True)
    nodes = {f"/node_{i}": Node(f"node_{i}") for i in range(30)}
    reports = {name: n.create_publisher(Header, REACHED_TOPIC, QOS) for name, n in nodes.items()}
    spin([bed, *nodes.values()], lambda: all(p.get_subscription_count() for p in reports.values()))
    for name, publisher in reports.items():  # the first one, which is the slowest, is not lost
        stamp = to_time(1_000_000_000 if name == "/node_0" else 2_000_000_000)
        publisher.publish(Header(stamp=stamp, frame_id=name))
    spin(bed, lambda: bed.timeline.nodes.slowest()[0] == "/node_0")


SCRIPT = """
- {at: 0.1, part: fss, fault: dropout, value: 0.3, duration: 0.5}
- {at: 0.1, part: end_effector, fault: occlusion, value: 0.3}
- {at: 0.5, part: link_3, fault: dead, duration: 0.1}
- {at: 0.5, part: fog, fault: bias, value: 0.01}
"""


def test_the_same_seed_and_script_give_the_same_bytes_in_stepped_time(spin, call, tmp_path):
    (tmp_path / "faults.yaml").write_text(SCRIPT)
    bed = testbed(
        keep_clock=True,
        paused=True,
        preset="laboratory",
        faults=str(tmp_path / "faults.yaml"),
        wifi=True,
        marker_noise=0.0003,
        vicon_occlusion=1.0,
        vicon_jitter=0.001,
    )
    sent = {}
    for publisher in bed.publishers:
        if publisher.topic_name not in REAL_TIME_TOPICS:
            publisher.publish = sent.setdefault(publisher.topic_name, []).append

    def run(seed):
        assert call(bed, "sim/reset", ResetTestbed, seed=seed).success
        for messages in sent.values():
            messages.clear()
        for frames in (30, 1, 69):
            assert call(bed, "sim/step", StepTime, frames=frames).success
        return {topic: tuple(messages) for topic, messages in sent.items()}

    first = run(seed=7)
    assert len(first["/clock"]) == len(first["/vicon/end_effector/end_effector"]) == 100
    assert len(first["/vicon/fss/fss"]) < 100
    assert len(first["/sim/faults"]) == 3  # at each event time of the script
    assert run(seed=7) == first
    assert run(seed=8)["/vicon/fss/fss"] != first["/vicon/fss/fss"]


def test_drivers_reach_links_over_each_transport(spin, tmp_path):
    paths = [str(tmp_path / f"link_{i}") for i in (1, 2, 3, 4)]
    angles = [0.1, 0.2, 0.3, 0.4]
    bed = testbed(transports=["udp", "tcp", "serial", "tcp"], terminals=paths, q=angles)
    ports = [getattr(wire, "port", 0) for wire in bed.wires]
    urls = [
        f"udp://127.0.0.1:{ports[0]}?bind=0",
        f"tcp://127.0.0.1:{ports[1]}",
        f"serial://{paths[2]}",
        f"tcp://127.0.0.1:{ports[3]}",
    ]
    links = [LinkNode(i, url) for i, url in enumerate(urls, 1)]
    spin([bed, *links], lambda: all(link.session.frame for link in links), 30.0)
    found = [link.session.scale.position(link.session.frame.position) for link in links]
    assert found == pytest.approx(angles, abs=0.01)


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
        return [row for m in recorded[-1:] for row in zip(m.part, m.fault, m.value, strict=True)]

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
        ({"terminals": ["/tmp/a"]}, "expected 4"),
        ({"preset": "none"}, "preset is 'none'"),
        ({"speed": 5.0}, "without keep_clock"),
        ({"paused": True}, "without keep_clock"),
        ({"ports": [0, 0]}, "expected 4"),
        ({"transports": ["tcp", "udp"]}, "transports is .*, expected 1 or 4"),
        ({"transports": ["serial"]}, "terminals has 0 paths, expected 4"),
        ({"transports": ["can"]}, "transports is 'can', expected one of udp, tcp, serial"),
        ({"tilt": (0.1,)}, "tilt has 1 numbers, expected 2"),
        ({"torque_rate": 50}, "expected 10 or 80"),
        ({"speed": 500.0, "keep_clock": True}, "speed is 500"),
        ({"table": (0.0, 4.0)}, "table"),
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
        with pytest.raises(
            OSError, match=f"UDP port {port} of 127.0.0.1 .*; another test bed runs, or"
        ):
            testbed(ports=[port, 0, 0, 0])


def test_the_charge_service_fills_empty_batteries(call):
    bed = testbed(battery=0.03, preset="ideal")
    for link in bed.testbed.links:
        link.supply.battery.charge = 1e-6
    assert call(bed, "sim/charge", Trigger).success
    assert all(link.supply.battery.charge > 0.9 for link in bed.testbed.links)


def test_a_full_tank_is_no_problem_in_diagnostics(spin):
    bed = testbed(bearing_flow=1e-6, keep_clock=True, preset="ideal")
    spin(bed, lambda: bed.testbed.frame > 20)
    assert "air" not in bed.health().message


def test_an_empty_tank_lays_the_vehicle_on_the_table_and_diagnostics_say_so(spin):
    bed = testbed(
        bearing_flow=2e-3, tank_volume=0.43e-5, twist=[0.1, 0.0, 0.05], keep_clock=True, speed=5.0,
        preset="ideal", table=[20.0, 20.0],
    )  # fmt: skip
    spin(bed, lambda: abs(bed.testbed.plant.qd[:3]).max() < 1e-4)
    assert "no air in the bearings: the vehicle rubs on the table" in bed.health().message


# --- thrusters, gripper, target and truth ---------------------------------------------------------

STEPPED = {"keep_clock": True, "speed": 20.0, "preset": "ideal"}


def target_before_tip(distance, q=(0.0, 0.0, 0.0, 0.0)):
    """Return a target pose with the fixture at a distance [m] from the tip of the arm."""
    x, y, heading = tip_pose(paper_arm().vector(), [0.0, 0.0, 0.0, *q]).tolist()
    at = complex(x, y) + (0.19 + distance) * np.exp(1j * heading)
    return [float(at.real), float(at.imag), heading + np.pi]


@pytest.fixture
def operator(ros):
    node = Node("operator")
    node.truth_message, node.gripper, node.target = [], [], []
    node.create_subscription(SimTruth, "sim/truth", node.truth_message.append, sensor())
    node.create_subscription(GripperState, "gripper/state", node.gripper.append, sensor())
    node.create_subscription(PoseStamped, "vicon/target/target", node.target.append, sensor())
    node.thrust = node.create_publisher(ThrusterCommand, "thrusters/command", COMMAND)
    node.grip = node.create_publisher(Bool, "gripper/command", COMMAND)
    return node


def test_thrusters_push_the_base_and_use_propellant(spin, operator):
    bed = testbed(**STEPPED)
    spin(
        [bed, operator], lambda: operator.truth_message and operator.thrust.get_subscription_count()
    )
    before = operator.truth_message[-1]
    assert before.q == pytest.approx([0.0] * 7)
    push = [0.0, 0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0]  # along x
    rejected = []
    slow = "too slow"  # on a busy computer
    bed.get_logger().warning = lambda words, **_: slow in words or rejected.append(words)
    operator.thrust.publish(ThrusterCommand(on_time=[-1.0] + 7 * [0.5]))
    seen = spin([bed, operator], lambda: rejected and len(operator.truth_message))
    spin([bed, operator], lambda: len(operator.truth_message) > seen + 2)
    assert operator.truth_message[-1].propellant == 0.0  # it opened no valve
    operator.thrust.publish(ThrusterCommand(on_time=push))
    spin([bed, operator], lambda: operator.truth_message[-1].impulse[0] > 0.15)
    spin([bed, operator], lambda: not any(operator.truth_message[-1].valves))
    after = operator.truth_message[-1]
    assert after.impulse[0] == pytest.approx(2 * 0.16 * 0.5, rel=0.01)
    assert after.propellant > 0.0
    assert after.pressure < before.pressure
    assert max(map(abs, [*after.momentum_error, after.energy_error])) < 1e-9
    assert not after.target_present
    assert not operator.target


def test_the_gripper_holds_and_releases_the_target(spin, operator):
    pose = target_before_tip(0.01)
    bed = testbed(**STEPPED, target_mass=8.0, target_pose=pose, table=[6.0, 6.0])
    spin([bed, operator], lambda: operator.gripper and operator.grip.get_subscription_count())
    state = operator.gripper[-1]
    assert (state.closed, state.holds) == (False, False)
    assert state.distance == pytest.approx(0.01, abs=1e-6)
    got = planar_pose(spin([bed, operator], lambda: operator.target and operator.target[-1].pose))
    np.testing.assert_allclose(got[:2], pose[:2], atol=1e-9)
    operator.grip.publish(Bool(data=True))
    spin([bed, operator], lambda: operator.gripper[-1].holds and operator.truth_message[-1].holds)
    operator.grip.publish(Bool(data=False))
    spin(
        [bed, operator],
        lambda: not (operator.gripper[-1].holds or operator.truth_message[-1].holds),
    )


def test_time_joints_held_target_and_used_propellant_survive_a_restart(spin, operator, tmp_path):
    path, q = str(tmp_path / "state.json"), [0.1, 0.2, 0.3, 0.4]
    given = {"target_mass": 8.0, "target_pose": target_before_tip(0.0, q), "table": [6.0, 6.0]}
    first = testbed(**STEPPED, **given, q=q, state_file=path)
    with first.lock:
        first.testbed.plant.closed = True
        first.testbed.plant.thrust([0.1] * 8)
    spin(
        [first, operator],
        lambda: operator.truth_message and operator.truth_message[-1].propellant > 0.0,
    )
    spin([first, operator], lambda: not any(operator.truth_message[-1].valves))
    first.close()
    kept = first.testbed.plant
    second = testbed(**STEPPED, **given, state_file=path)
    with second.lock:
        again = second.testbed.plant
        assert second.testbed.boot == first.testbed.boot % 65535 + 1
        assert second.timeline.stamp() > stamp_ns(operator.truth_message[-1].header.stamp)
        np.testing.assert_allclose(again.q[3:], kept.q[3:], atol=1e-4)
        assert again.holds
        assert again.thrusters.propellant_used == kept.thrusters.propellant_used > 0.0
        np.testing.assert_allclose(again._p, kept._p, rtol=0, atol=1e-12)
    second.close()


# --- serialized messages are those that are created and serialized each time ----------------------

STAMP = 1_700_000_000_123_456_789


@pytest.mark.parametrize("frame_id", ["", "w", "world", "a_longer_name_of_the_world"])
def test_a_pose_equals_the_converted_one_and_an_occluded_subject_is_all_zero(frame_id):
    message, occluded = SerializedPose(frame_id), PoseStamped()
    occluded.header.stamp, occluded.header.frame_id = to_time(STAMP), frame_id
    occluded.pose.orientation.w = 0.0
    for pose in ((1.5, -2.5, 3.0), (0.0, 1e-9, -0.1)):
        for hidden, expected in ((True, occluded), (False, pose_stamped(STAMP, frame_id, pose))):
            data = message.serialize(STAMP, SubjectReading(pose, occluded=hidden))
            assert deserialize_message(data, PoseStamped) == expected


def test_the_gyro_message_has_its_rate_and_marks_unmeasured_fields():
    got = deserialize_message(SerializedGyro("fss", 0.01).serialize(STAMP, -0.25), Imu)
    expected = Imu()
    expected.header.stamp, expected.header.frame_id = to_time(STAMP), "fss"
    expected.orientation_covariance[0] = expected.linear_acceleration_covariance[0] = -1.0
    expected.angular_velocity.z, expected.angular_velocity_covariance[8] = -0.25, 0.01**2
    assert repr(got) == repr(expected)  # == is ambiguous for arrays


def test_the_clock_is_exact():
    data = SerializedClock().serialize(STAMP)
    assert deserialize_message(data, Clock) == Clock(clock=to_time(STAMP))


@pytest.fixture
def frequent_switches():
    """Switch between threads as often as possible."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_diagnostics_do_not_change_the_motion(ros, frequent_switches):
    """They compute gaps, from the states that the simulation's thread advances."""
    bed, pushes = testbed(**STEPPED), itertools.cycle(np.eye(8)[[2, 0, 4, 6]])
    while bed.frame < 3000:
        with bed.lock:
            bed.testbed.plant.thrust(0.02 * next(pushes))
        bed.health()
    with bed.lock:
        assert np.abs(bed.testbed.bed.imbalance[:3]).max() < 1e-9  # [N s, N m s]
    bed.close()
