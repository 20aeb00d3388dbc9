"""The node base_reaction, which receives the messages of a flight."""

import signal
from dataclasses import replace
from time import monotonic

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, JointState
from view_bench import BEGIN, Bench
from view_flight import paper_flight

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import load, to_yaml
from fss_arm_msgs.msg import Calibration, DynamicCalibration, KinematicCalibration, ThrusterCommand
from fss_arm_ros.convert import SECOND, pose_stamped, stamp_ns, to_time
from fss_arm_ros.diagnostics import OK
from fss_arm_view.base_reaction_node import DYNAMIC, KINEMATIC, BaseReactionNode


@pytest.fixture(scope="module")
def flight():
    return paper_flight()


@pytest.fixture
def run(spin, flight):
    def start(**settings):
        node = BaseReactionNode(
            parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
        )
        bench = Bench(flight)
        spin([node, bench], bench.ready)
        return node, bench

    return start


def play_all(spin, node, bench):
    """Play the flight in parts, so that no queue overflows."""
    while bench.k < len(bench.flight.t):
        bench.play(500)
        frames = min(bench.k, len(bench.flight.t)) // 10
        spin([node, bench], lambda n=frames: len(bench.states) >= n - 6, 30.0)  # some are queued


def test_prediction_measurement_and_state_agree_on_topics(run, spin, flight):
    """The base's state is in base axes, and on tf."""
    node, bench = run(world_frame="table", base_frame="hub")
    play_all(spin, node, bench)
    spin([node, bench], lambda: len(bench.reactions) > 40)
    last = bench.reactions[-1]
    k = (stamp_ns(last.header.stamp) - BEGIN) // 1_000_000
    assert last.header.frame_id == "table"
    assert last.arm == "paper"
    assert stamp_ns(last.anchor) < BEGIN + 2_500_000_000 < stamp_ns(last.header.stamp)
    # Readings 0.2 s apart, and a filter that smooths.
    np.testing.assert_allclose(last.predicted, flight.pose[k], atol=5e-3)
    np.testing.assert_allclose(last.measured, flight.pose[k], atol=5e-3)
    np.testing.assert_allclose(
        last.difference, np.subtract(last.measured, last.predicted), atol=1e-15
    )
    assert last.torque_measured == 0.25
    steps = np.diff([stamp_ns(m.header.stamp) for m in bench.reactions])
    assert set(steps.tolist()) == {100_000_000}
    assert max(abs(m.torque) for m in bench.reactions) > 0.05

    state, transform = bench.states[-1], bench.transforms[-1].transforms[0]
    k = (stamp_ns(state.header.stamp) - BEGIN) // 1_000_000
    x, y, heading = flight.pose[k]
    vx, vy, omega = flight.twist[k]
    for m in (state, transform):
        assert (m.header.frame_id, m.child_frame_id) == ("table", "hub")
    assert state.pose.pose.position.x == pytest.approx(x, abs=1e-3)
    assert transform.transform.translation.y == pytest.approx(y, abs=1e-3)
    measured = 2.0 * np.arctan2(transform.transform.rotation.z, transform.transform.rotation.w)
    assert measured == pytest.approx(heading, abs=2e-3)
    assert abs(heading) > 0.2  # or the axes would not matter
    own = complex(vx, vy) * np.exp(-1j * heading)
    twist = state.twist.twist
    assert complex(twist.linear.x, twist.linear.y) == pytest.approx(own, abs=2e-3)
    assert twist.angular.z == pytest.approx(omega, abs=2e-3)


@pytest.fixture
def node(ros):
    node = BaseReactionNode()
    yield node
    node.destroy_node()


def fly(node, flight, late=0.0, gyro_late=0.0):
    """Feed a flight to a node, with late stamps of joints and gyro [s]; return its reactions."""
    found = []
    node.reaction_publisher.publish = found.append
    names = [f"joint_{i + 1}" for i in range(4)]
    for k in range(0, len(flight.t), 10):
        t = 0.001 * k
        joints = JointState(name=names, position=flight.q[k], velocity=flight.qd[k])
        joints.header.stamp = to_time(BEGIN + int((t + late) * SECOND))
        node.on_joints(joints)
        node.on_gyro(gyro_sample(t + gyro_late, float(flight.twist[k, 2])))
        node.on_pose(pose_stamped(BEGIN + k * 1_000_000, "world", tuple(flight.pose[k])))
    return found


def test_no_difference_is_published_after_thrusters_fired(node, flight):
    thrust = ThrusterCommand(on_time=[0.0, 0.2, *[0.0] * 6])
    thrust.header.stamp = to_time(BEGIN + int(2.6 * SECOND))
    node.on_thrust(thrust)
    last = fly(node, flight)[-1]
    assert np.isnan(last.difference).all()
    assert np.isfinite(last.predicted).all()


@pytest.mark.parametrize(("late", "gyro_too"), [(0.05, False), (-0.05, True)])
def test_the_clock_offset_of_a_calibration_is_applied(node, flight, late, gyro_too):
    """Unless it is, the prediction is worse."""
    kind, topic = (DynamicCalibration, DYNAMIC) if gyro_too else (KinematicCalibration, KINEMATIC)
    found = Calibration(verdict="pass", description=to_yaml(paper_arm()), time_offset=late)
    node.on_calibration(topic, kind(calibration=found))
    other = BaseReactionNode()
    good, bad = (
        max(abs(r.difference[2]) for r in fly(one, flight, late, late * gyro_too))
        for one in (node, other)
    )
    other.destroy_node()
    assert good < 1e-3
    assert bad > 5e-3


def test_a_calibration_that_passed_is_used_and_one_that_failed_is_not(run, spin):
    node, bench = run()
    truth = load("config/truth.yaml")
    message = KinematicCalibration(
        calibration=Calibration(
            verdict="fail", description=to_yaml(truth), names=["a"], covariance=[1e-4]
        )
    )
    bench.calibration.publish(message)
    message.calibration.verdict = "pass"
    bench.calibration.publish(message)
    spin([node, bench], lambda: node.calibrated.arm == truth)
    assert node.reaction.covariance.any()


def base_pose(t):
    """Return a pose of the resting base at t [s]."""
    return pose_stamped(BEGIN + int(t * SECOND), "world", (0.1, 0.2, 0.3))


def readings(t, names=("joint_1", "joint_2", "joint_3", "joint_4"), **values):
    """Return readings of the resting arm at t [s]."""
    message = JointState(name=list(names), position=[0.1] * len(names), **values)
    message.header.stamp = to_time(BEGIN + int(t * SECOND))
    return message


def gyro_sample(t, rate):
    """Return a gyro sample at t [s]."""
    message = Imu()
    message.header.stamp, message.angular_velocity.z = to_time(BEGIN + int(t * SECOND)), rate
    return message


@pytest.fixture
def time_limit():
    """Fail the test if it hangs."""
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it hangs"))
    signal.alarm(60)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("occlusion", [(0.0, 2.0), (3.0, 9.0)])
def test_missing_base_poses_do_not_block_the_node(node, time_limit, occlusion):
    """Joints lag behind the poses, which start late or pause for longer than the history."""
    for k in range(1200):
        t = 0.01 * k
        if not occlusion[0] <= t < occlusion[1]:
            node.on_pose(base_pose(t))
        if k % 20 == 7:
            node.on_joints(readings(t, velocity=[0.0] * 4))
    assert node.reaction.t > BEGIN + 11 * SECOND
    assert node.health().level == OK


@pytest.mark.parametrize("straggler", [False, True])
def test_a_backward_jump_of_stamps_resets_the_node(node, capfd, straggler):
    """A looping replay does so; one reading far ahead, or one that arrives late, does no harm."""
    node.calibrated = replace(node.calibrated, arm=load("config/truth.yaml"))
    for begin in (100, 0):
        for k in range(600):
            t = begin + 0.01 * k
            node.on_pose(base_pose(t))
            node.on_gyro(gyro_sample(t, 0.0))
            if k % 5 == 2:
                node.on_joints(readings(t, velocity=[0.0] * 4))
            if k == 20 and straggler:
                node.on_joints(readings(106.0, velocity=[0.0] * 4))
        assert BEGIN + (begin + 5) * SECOND < node.reaction.t < BEGIN + (begin + 6) * SECOND
        assert node.health().level == OK
    np.testing.assert_array_equal(node.reaction.p, load("config/truth.yaml").vector())
    assert capfd.readouterr().err.count("filter and prediction reset") == 1 + 2 * straggler


def test_a_pose_that_is_repeated_while_the_arm_moves_is_rejected(node):
    """At rest it is accepted, as poses of a simulator without noise."""
    for k in range(300):
        if k % 20 == 0:
            node.on_joints(readings(0.01 * k, velocity=[0.0, 0.0, 0.1 * (k == 100), 0.0]))
        node.on_pose(base_pose(0.01 * k))
    assert node.filter.rejected == {"frozen": 20}
    assert node.health().values["frozen rejected"] == 20
    assert node.reaction.t > BEGIN + 2 * SECOND


def test_a_gyro_ahead_of_the_poses_is_reported(node):
    for k in range(100):
        node.on_gyro(gyro_sample(2.0 + 0.01 * k, 0.0))
        node.on_pose(base_pose(0.01 * k))
    late = node.filter.rejected["late"]
    assert late > 50
    assert node.health().message.endswith(f"; late samples of the base rejected: {late}")


def test_readings_do_not_accumulate_without_a_base(node):
    """Readings without rate and those of other joints are ignored."""
    node.on_joints(readings(0.0))
    node.on_joints(readings(0.1, names=("gripper", "joint_5", "joint_x"), velocity=[0.0] * 3))
    assert not any(joint.t for joint in node.reaction.joints)
    for k in range(2000):
        node.on_joints(readings(0.2 * k, velocity=[0.0] * 4))
    assert len(node.reaction.joints[0].t) < 200
    assert node.health().message == "nothing received from vicon/fss/fss"


def test_missing_inputs_are_named(node, monkeypatch):
    assert node.health().message == (
        "nothing received from joint_1, joint_2, joint_3, joint_4, vicon/fss/fss"
    )
    node.on_pose(base_pose(-0.02))
    node.on_joints(readings(-0.02, names=("joint_1", "joint_2", "joint_4"), velocity=[0.0] * 3))
    assert node.health().message == "nothing received from joint_3"
    for k in range(100):
        node.on_pose(base_pose(0.02 * k))
        node.on_joints(readings(0.02 * k, velocity=[0.0] * 4))
    assert node.health().level == OK
    later = monotonic() + 5.0
    monkeypatch.setattr("fss_arm_view.base_reaction_node.monotonic", lambda: later)
    node.on_joints(readings(0.02 * 99, velocity=[0.0] * 4))  # no new stamp
    message = node.health().message
    assert message.startswith("nothing published for 5.")
    assert message.endswith(" s: nothing received from vicon/fss/fss")


def test_commands_to_thrusters_that_base_may_reject_are_ignored(node):
    counts = [node.count_subscribers(f"thrusters/{name}") for name in ("pulses", "command")]
    assert counts == [1, 0]


@pytest.mark.parametrize("rate", [0.5, 1e10])
def test_an_impossible_rate_is_named(ros, rate):
    with pytest.raises(ValueError, match=r"rate is .* Hz, expected 1 to 100"):
        BaseReactionNode(parameter_overrides=[Parameter("rate", value=rate)])


THREE = replace(paper_arm(), links=paper_arm().links[:3])


@pytest.mark.parametrize(
    ("arm", "name", "words"),
    [
        (THREE, "a", "it is for 3 links, expected 4"),
        (paper_arm(), "zeta", "has no parameter 'zeta'"),
    ],
)
def test_a_calibration_of_another_arm_is_ignored(run, spin, capfd, arm, name, words):
    node, bench = run()
    found = Calibration(verdict="pass", description=to_yaml(arm), names=[name], covariance=[1.0])
    bench.calibration.publish(KinematicCalibration(calibration=found))
    spin([node, bench], lambda: words in capfd.readouterr().err)
    assert node.calibrated.arm == paper_arm()
    assert not node.reaction.covariance.any()


def test_an_occluded_base_is_counted(run, spin):
    node, bench = run()
    occluded = PoseStamped()
    occluded.pose.orientation.w = 0.0  # receivers publish occluded subjects so
    bench.pose.publish(occluded)
    spin([node, bench], lambda: node.health().values["poses occluded"] == 1)
    assert not bench.states


def test_the_base_s_state_can_be_published_by_navigation(ros):
    node = BaseReactionNode(parameter_overrides=[Parameter("publish_state", value=False)])
    topics = node.get_publisher_names_and_types_by_node("base_reaction", "/")
    published = {name for name, _ in topics}
    assert "/base_reaction" in published
    assert not {"/base/state", "/tf"} & published
    for k in range(100):
        node.on_pose(base_pose(0.01 * k))
    assert node.filter.t == BEGIN + 99 * SECOND // 100
    node.destroy_node()
