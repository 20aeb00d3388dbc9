"""The node base_reaction, fed with the messages of a flight."""

import signal
from dataclasses import replace

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
    """Play in pieces that no queue overflows from."""
    while bench.k < len(bench.flight.t):
        bench.play(500)
        frames = min(bench.k, len(bench.flight.t)) // 10
        spin([node, bench], lambda n=frames: len(bench.states) >= n - 6, 30.0)  # some wait


def test_prediction_and_measurement_agree_on_topics(run, spin, flight):
    node, bench = run()
    play_all(spin, node, bench)
    spin([node, bench], lambda: len(bench.reactions) > 60)
    last = bench.reactions[-1]
    k = (stamp_ns(last.header.stamp) - BEGIN) // 1_000_000
    assert last.header.frame_id == "world"
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


@pytest.mark.parametrize(
    ("fired", "lasts", "known"), [(-10.0, 0.2, True), (2.6, 0.2, False), (2.6, np.inf, True)]
)
def test_where_thrusters_fired_nothing_is_compared(run, spin, fired, lasts, known):
    node, bench = run()
    thrust = ThrusterCommand(on_time=[0.0, lasts, *[0.0] * 6])
    thrust.header.stamp = to_time(BEGIN + int(fired * SECOND))
    node.on_thrust(thrust)
    play_all(spin, node, bench)
    spin([node, bench], lambda: len(bench.reactions) > 60)
    assert np.isfinite(bench.reactions[-1].difference).all() == known
    assert np.isfinite(bench.reactions[-1].predicted).all()


def test_the_base_s_state_is_in_its_own_axes_and_on_tf(run, spin, flight):
    node, bench = run(world_frame="table", base_frame="hub")
    play_all(spin, node, bench)
    state, transform = bench.states[-1], bench.transforms[-1].transforms[0]
    k = (stamp_ns(state.header.stamp) - BEGIN) // 1_000_000
    x, y, heading = flight.pose[k]
    vx, vy, omega = flight.twist[k]
    for m in (state, transform):
        assert (m.header.frame_id, m.child_frame_id) == ("table", "hub")
    assert state.pose.pose.position.x == pytest.approx(x, abs=1e-3)
    assert transform.transform.translation.y == pytest.approx(y, abs=1e-3)
    turned = 2.0 * np.arctan2(transform.transform.rotation.z, transform.transform.rotation.w)
    assert turned == pytest.approx(heading, abs=2e-3)
    assert abs(heading) > 0.2  # or the axes would not matter
    own = complex(vx, vy) * np.exp(-1j * heading)
    twist = state.twist.twist
    assert complex(twist.linear.x, twist.linear.y) == pytest.approx(own, abs=2e-3)
    assert twist.angular.z == pytest.approx(omega, abs=2e-3)


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
    spin([node, bench], lambda: node.known.arm == truth)
    assert node.reaction.covariance.any()


def seen(t):
    """The base at rest."""
    return pose_stamped(BEGIN + int(t * SECOND), "world", (0.1, 0.2, 0.3))


def read(t, names=("joint_1", "joint_2", "joint_3", "joint_4"), **values):
    """The arm at rest."""
    message = JointState(name=list(names), position=[0.1] * len(names), **values)
    message.header.stamp = to_time(BEGIN + int(t * SECOND))
    return message


def turned(t, rate):
    """The base's rate."""
    message = Imu()
    message.header.stamp, message.angular_velocity.z = to_time(BEGIN + int(t * SECOND)), rate
    return message


@pytest.fixture
def in_time():
    """The test fails if it hangs."""
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it hangs"))
    signal.alarm(60)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("unseen", [(0.0, 2.0), (3.0, 9.0)])
def test_a_base_that_was_not_seen_holds_nothing_up(ros, in_time, unseen):
    """Joints lag behind the poses, which begin late or pause for longer than any is kept."""
    node = BaseReactionNode()
    for k in range(1200):
        t = 0.01 * k
        if not unseen[0] <= t < unseen[1]:
            node.on_pose(seen(t))
        if k % 20 == 7:
            node.on_joints(read(t, velocity=[0.0] * 4))
    assert node.reaction.t > BEGIN + 11 * SECOND
    assert node.health().level == OK
    node.destroy_node()


@pytest.mark.parametrize("straggler", [False, True])
def test_stamps_that_go_back_begin_anew(ros, capfd, straggler):
    """As in a replay that loops; one reading far ahead, or still on its way, does no harm."""
    node = BaseReactionNode()
    node.known = replace(node.known, arm=load("config/truth.yaml"))
    for begin in (100, 0):
        for k in range(600):
            t = begin + 0.01 * k
            node.on_pose(seen(t))
            node.on_gyro(turned(t, 0.0))
            if k % 5 == 2:
                node.on_joints(read(t, velocity=[0.0] * 4))
            if k == 20 and straggler:
                node.on_joints(read(106.0, velocity=[0.0] * 4))
        assert BEGIN + (begin + 5) * SECOND < node.reaction.t < BEGIN + (begin + 6) * SECOND
        assert node.health().level == OK
    np.testing.assert_array_equal(node.reaction.p, load("config/truth.yaml").vector())
    assert capfd.readouterr().err.count("begins anew") == 1 + 2 * straggler
    node.destroy_node()


def test_a_pose_that_is_repeated_while_the_arm_moves_is_rejected(ros):
    """And believed at rest, as of a simulator without noise."""
    node = BaseReactionNode()
    for k in range(300):
        if k % 20 == 0:
            node.on_joints(read(0.01 * k, velocity=[0.0, 0.0, 0.1 * (k == 100), 0.0]))
        node.on_pose(seen(0.01 * k))
    assert node.filter.rejected == {"frozen": 20}
    assert node.health().values["frozen rejected"] == 20
    assert node.reaction.t > BEGIN + 2 * SECOND
    node.destroy_node()


@pytest.mark.parametrize(("late", "gyro_too"), [(0.05, False), (0.05, True), (-0.05, True)])
def test_the_clocks_offset_that_a_calibration_found_is_allowed_for(ros, flight, late, gyro_too):
    kind, topic = (DynamicCalibration, DYNAMIC) if gyro_too else (KinematicCalibration, KINEMATIC)
    worst = {}
    for told in (0.0, late):
        node, found = BaseReactionNode(), []
        node.reacted.publish = found.append
        description = to_yaml(paper_arm())
        node.on_calibration(
            topic,
            kind(
                calibration=Calibration(verdict="pass", description=description, time_offset=told)
            ),
        )
        for k in range(0, len(flight.t), 10):
            t = 0.001 * k
            names = [f"joint_{i + 1}" for i in range(4)]
            joints = JointState(name=names, position=flight.q[k], velocity=flight.qd[k])
            joints.header.stamp = to_time(BEGIN + int((t + late) * SECOND))
            node.on_joints(joints)
            node.on_gyro(turned(t + late * gyro_too, float(flight.twist[k, 2])))
            node.on_pose(pose_stamped(BEGIN + k * 1_000_000, "world", tuple(flight.pose[k])))
        worst[told] = max(abs(r.difference[2]) for r in found)
        node.destroy_node()
    assert worst[late] < 1e-3
    assert worst[0.0] > 5e-3


def test_a_gyro_ahead_of_the_poses_is_told_of(ros):
    node = BaseReactionNode()
    for k in range(100):
        node.on_gyro(turned(2.0 + 0.01 * k, 0.0))
        node.on_pose(seen(0.01 * k))
    late = node.filter.rejected["late"]
    assert late > 50
    assert node.health().message.endswith(f"; {late} samples of the base came late")
    node.destroy_node()


def test_readings_do_not_pile_up_without_a_base(ros):
    node = BaseReactionNode()
    for k in range(2000):
        node.on_joints(read(0.2 * k, velocity=[0.0] * 4))
    assert len(node.reaction.joints[0].t) < 200
    assert node.health().message == "waiting for joints and base at rest"
    node.destroy_node()


def test_joints_of_others_and_readings_without_rate_are_left_out(ros):
    node = BaseReactionNode()
    node.on_joints(read(0.0))
    node.on_joints(read(0.1, names=("gripper", "joint_5", "joint_x"), velocity=[0.0] * 3))
    assert not any(joint.t for joint in node.reaction.joints)
    node.destroy_node()


def test_a_calibration_of_another_arm_is_left_out(run, spin, capfd):
    node, bench = run()
    three = replace(paper_arm(), links=paper_arm().links[:3])
    bench.calibration.publish(
        KinematicCalibration(calibration=Calibration(verdict="pass", description=to_yaml(three)))
    )
    spin([node, bench], lambda: "it is for 3 links, expected 4" in capfd.readouterr().err)
    assert node.known.arm == paper_arm()


def test_a_parameter_that_nobody_knows_ends_nothing(run, spin, capfd):
    node, bench = run()
    odd = Calibration(
        verdict="pass", description=to_yaml(paper_arm()), names=["zeta"], covariance=[1.0]
    )
    bench.calibration.publish(KinematicCalibration(calibration=odd))
    spin([node, bench], lambda: "has no parameter 'zeta'" in capfd.readouterr().err)
    assert not node.reaction.covariance.any()


def test_an_occluded_base_is_counted(run, spin):
    node, bench = run()
    nothing = PoseStamped()
    nothing.pose.orientation.w = 0.0  # as receivers publish a subject they do not see
    bench.pose.publish(nothing)
    spin([node, bench], lambda: node.health().values["poses occluded"] == 1)
    assert not bench.states


def test_the_base_s_state_is_left_to_navigation(ros):
    node = BaseReactionNode(parameter_overrides=[Parameter("publish_state", value=False)])
    topics = node.get_publisher_names_and_types_by_node("base_reaction", "/")
    published = {name for name, _ in topics}
    assert "/base_reaction" in published
    assert not {"/base/state", "/tf"} & published
    for k in range(100):
        node.on_pose(seen(0.01 * k))
    assert node.filter.t == BEGIN + 99 * SECOND // 100
    node.destroy_node()
