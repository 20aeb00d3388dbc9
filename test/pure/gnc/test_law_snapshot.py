"""Inputs of a control law at one time, from messages of several times."""

import numpy as np
import pytest

from fss_arm_model.units import SECOND
from fss_gnc.law.snapshot import Snapshot, world_covariance
from fss_gnc.reference import Body, Path

NOW = 1000 * SECOND


@pytest.fixture
def snapshot():
    made = Snapshot(2, 0.02)
    made.base.store(NOW - SECOND // 10, Body(np.array([1.0, 2.0, 0.5]), np.array([0.1, 0.0, -0.2])))
    made.joints.store(NOW - SECOND // 5, np.array([[0.3, -0.4], [0.05, 0.1], [np.nan, np.nan]]))
    return made


def test_base_and_joints_are_extrapolated_to_one_time(snapshot):
    inputs = snapshot.at(NOW)
    np.testing.assert_allclose(inputs.base_pose, [1.01, 2.0, 0.48])
    np.testing.assert_allclose(inputs.joint_angles, [0.31, -0.38])
    assert inputs.base_age == pytest.approx(0.1)
    assert (inputs.time, inputs.period, inputs.joints) == (0.0, 0.02, 2)
    assert inputs.target_pose is inputs.target_twist is inputs.propellant is None
    assert snapshot.at(NOW + SECOND // 10).time == pytest.approx(0.1)


def test_without_base_or_joints_there_are_no_inputs(snapshot):
    for now in (NOW + SECOND // 2, NOW - 2 * SECOND):
        assert snapshot.at(now) is None
    assert snapshot.problem(NOW + SECOND // 2) == "base/state is 0.6 s old"
    assert Snapshot(2, 0.02).problem(NOW) == "waiting for base/state"


def test_without_a_trajectory_the_base_is_held_where_it_was(snapshot):
    first = snapshot.at(NOW).reference_pose
    later = snapshot.at(NOW + SECOND // 10)
    np.testing.assert_array_equal(later.reference_pose, first)
    assert not np.array_equal(later.base_pose, first)
    assert not later.reference_twist.any()


def test_a_trajectory_is_the_reference_until_it_expires(snapshot):
    knots = np.zeros((2, 2, 3))
    knots[:, 1, 0], knots[1, 0, 0] = 0.02, 0.1
    start = NOW - SECOND
    snapshot.trajectory.store(NOW, (start, Path(np.array([0.0, 5.0]), knots)))
    inputs = snapshot.at(NOW)
    np.testing.assert_allclose(inputs.reference_pose, [0.02, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(inputs.reference_twist, [0.02, 0.0, 0.0], atol=1e-12)
    snapshot.trajectory.store(NOW - 2 * SECOND, snapshot.trajectory.value)
    np.testing.assert_allclose(snapshot.at(NOW).reference_pose, [1.01, 2.0, 0.48])


def test_a_trajectory_without_points_leaves_no_inputs(snapshot):
    snapshot.trajectory.store(NOW, (NOW, None))
    assert snapshot.at(NOW) is None
    assert snapshot.problem(NOW) == "base/trajectory has no points"


def test_after_coasting_the_base_is_held_where_it_is_then(snapshot):
    snapshot.at(NOW)
    snapshot.trajectory.store(NOW, (NOW, None))
    assert snapshot.at(NOW) is None
    later = NOW + 2 * SECOND
    snapshot.base.store(later, Body(np.array([3.0, 2.0, 0.5]), np.zeros(3)))
    snapshot.joints.store(later, snapshot.joints.value)
    np.testing.assert_array_equal(snapshot.at(later).reference_pose, [3.0, 2.0, 0.5])


def test_boards_count_as_armed_while_they_report_it(snapshot):
    snapshot.valves_armed.store(NOW, True)
    snapshot.links_armed[1].store(NOW, True)
    snapshot.links_armed[0].store(NOW - 3 * SECOND, True)
    inputs = snapshot.at(NOW)
    assert inputs.valves_armed
    assert inputs.joints_armed.tolist() == [False, True]
    assert snapshot.disarmed(NOW) == "; disarmed: links 1"
    snapshot.links_armed[0].store(NOW, True)
    assert snapshot.disarmed(NOW) == ""
    assert snapshot.disarmed(NOW + 3 * SECOND) == "; disarmed: the base's board and links 1, 2"


def test_the_covariance_of_the_twist_is_turned_into_the_world():
    got = world_covariance(np.diag([1.0, 2.0, 3.0]), np.diag([4.0, 0.0, 5.0]), np.pi / 2)
    np.testing.assert_allclose(np.diag(got), [1.0, 2.0, 3.0, 0.0, 4.0, 5.0], atol=1e-12)
