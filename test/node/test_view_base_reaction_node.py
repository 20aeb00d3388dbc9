"""The node base_reaction, fed with the messages of a flight."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from view_bench import BEGIN, Bench
from view_flight import paper_flight

from fss_arm_model.description import load, to_yaml
from fss_arm_msgs.msg import KinematicCalibration
from fss_arm_ros.convert import stamp_ns
from fss_arm_view.base_reaction_node import BaseReactionNode


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
        verdict="fail", description=to_yaml(truth), names=["a"], covariance=[1e-4]
    )
    bench.calibration.publish(message)
    message.verdict = "pass"
    bench.calibration.publish(message)
    spin([node, bench], lambda: node.known.arm == truth)
    assert node.reaction.covariance.any()


def test_an_occluded_base_is_counted(run, spin):
    node, bench = run()
    nothing = PoseStamped()
    nothing.pose.orientation.w = 0.0  # as receivers publish a subject they do not see
    bench.pose.publish(nothing)
    spin([node, bench], lambda: node.health().values["poses occluded"] == 1)
    assert not bench.states
