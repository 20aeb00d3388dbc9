"""The filter of one body, on simulated motions; publication of its state, and problems."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_gnc.navigation import BodyFilter, Navigation, SensorErrors
from fss_gnc.navigation.health import diagnostic_values, find_problems, valve_problems
from fss_gnc.navigation.tracked_body import TrackedBody
from fss_gnc.navigation.valve_faults import Faults

MS = 1_000_000


def truth(t):
    return np.array([0.05 * t, -0.02 * t, 3.0 + 0.2 * t + 0.3 * np.sin(t)])


def fly(filter_, errors, seed, end=20.0):
    """Filter a base that turns and drifts: poses at 100 Hz, gyro at 100 Hz with a bias."""
    rng = np.random.default_rng(seed)
    states = []
    for k in range(int(end * 100)):
        t = 10 * MS * k
        x, y, heading = truth(t * 1e-9) + rng.normal(
            0, [errors.position_error, errors.position_error, errors.heading_error]
        )
        wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
        assert filter_.update_pose(t, x, y, wrapped)
        states.append(filter_.state())
        omega = 0.2 + 0.3 * np.cos(t * 1e-9 + 0.005) + 0.003 + rng.normal(0, errors.rate_error)
        filter_.update_rate(t + 5 * MS, omega)
    return states


def test_filter_errors_match_its_covariance():
    errors = SensorErrors(bias_walk=1e-6)
    late = [e for e in fly(BodyFilter(errors), errors, 1) if e.t > 10_000 * MS]
    off = np.array([e.pose - truth(e.t * 1e-9) for e in late])
    assert (np.abs(off) < 5.0 * np.sqrt(late[-1].pose_variance)).all()
    assert np.abs(off[:, 2]).max() < 0.5 * errors.heading_error  # the gyro helps
    assert late[-1].pose[2] > 3.0 + 3.0  # unwrapped
    rates = np.array([e.twist[2] - 0.2 - 0.3 * np.cos(e.t * 1e-9) for e in late])
    assert np.abs(rates).max() < 5.0 * late[-1].twist_variance[2] ** 0.5  # bias 0.003 states


def resting(poses=100, **errors):
    filter_ = BodyFilter(SensorErrors(**errors))
    for k in range(poses):
        filter_.update_pose(10 * MS * k, 0.0, 0.0, 0.0)
    return filter_


def test_outliers_are_rejected_and_only_a_moved_body_restarts_the_filter():
    filter_, rng = resting(), np.random.default_rng(1)
    random = rng.uniform(0.5, 2.0, (50, 3))
    assert not any(filter_.update_pose(10 * MS * (100 + k), *pose) for k, pose in enumerate(random))
    assert all(filter_.update_pose(10 * MS * k, 0.0, 0.0, 0.0) for k in range(150, 200))
    assert filter_.rejected == {"pose": 50}
    assert filter_.start_count == 1
    assert np.abs(filter_.state().pose).max() < 1e-6
    accepted = [filter_.update_pose(10 * MS * k, 1.0, 1.0, 1.0) for k in range(200, 260)]
    assert accepted.index(True) == 30  # after the settle time
    assert filter_.start_count == 2
    np.testing.assert_allclose(filter_.state().pose, 1.0, atol=1e-6)


def test_filter_follows_a_kick():
    filter_ = resting(acceleration=1e-3, position_error=3e-4)
    for k in range(100, 200):
        filter_.update_pose(10 * MS * k, 5e-4 * (k - 100), 0.0, 0.0)  # 5 cm/s at once
    assert filter_.start_count == 1
    assert filter_.rejected.total() == 0
    assert filter_.state().twist[0] == pytest.approx(0.05, rel=0.05)


def test_poses_of_another_body_are_rejected_under_its_name():
    filter_ = BodyFilter(other_body_at=lambda t, pose, within: "target" if within > 0.5 else "")
    for k in range(100):
        filter_.update_pose(10 * MS * k, 0.0, 0.0, 0.0)
    for k in range(100, 300):
        filter_.update_pose(10 * MS * k, 1.0, 1.0, 1.0)
    assert filter_.rejected == {"pose of the target": 200}
    assert filter_.start_count == 1


def test_nan_rate_is_rejected():
    filter_, clean = BodyFilter(), BodyFilter()
    for k in range(50):
        for one in (filter_, clean):
            one.update_rate(10 * MS * k, 0.1)
            one.update_pose(10 * MS * k, 0.0, 0.0, 0.001 * k)
        filter_.update_rate(10 * MS * k, float("nan"))
    assert filter_.rejected == {"gyro not finite": 50}
    np.testing.assert_array_equal(filter_.state().pose, clean.state().pose)


def test_order_of_arrival_does_not_matter():
    merged, ordered = BodyFilter(), BodyFilter()
    rng = np.random.default_rng(2)
    samples = [(10 * MS * k, rng.normal(0, 1e-3, 3)) for k in range(50)]
    for k in range(50):
        ordered.update_pose(samples[k][0], *samples[k][1])
        ordered.update_rate(samples[k][0] + 5 * MS, 0.1)
    merged.update_pose(samples[0][0], *samples[0][1])
    for k in range(50):
        merged.update_rate(samples[k][0] + 5 * MS, 0.1)  # 0.1 s ahead of the poses
        if k >= 10:
            merged.update_pose(samples[k - 9][0], *samples[k - 9][1])
    for k in range(41, 50):
        merged.update_pose(samples[k][0], *samples[k][1])
    np.testing.assert_allclose(merged.state().pose, ordered.state().pose, atol=1e-12)
    np.testing.assert_allclose(merged.state().covariance, ordered.state().covariance, rtol=1e-9)
    merged.update_pose(-1000 * MS, 0.0, 0.0, 0.0)
    assert merged.rejected == {"late": 1}


def test_state_is_lost_after_an_outage_and_found_again():
    filter_ = resting(acceleration=1e-3, position_error=3e-4, angular_acceleration=3e-3)
    filter_.predict(1990 * MS)
    assert filter_.lost_reason(1990 * MS) == ""
    deviations = np.sqrt(filter_.state().pose_variance)
    filter_.predict(4000 * MS)
    assert filter_.lost_reason(4000 * MS) == "not observed for 3.0 s"
    assert (np.sqrt(filter_.state().pose_variance) > 2.0 * deviations).all()
    assert filter_.update_pose(4001 * MS, 0.001, 0.0, 0.0)
    assert (filter_.lost_reason(4001 * MS), filter_.start_count) == ("", 1)


def test_uncertain_state_is_lost_before_the_outage_timeout():
    filter_ = resting(acceleration=0.05)
    filter_.predict(1990 * MS)
    assert filter_.lost_reason(1990 * MS).startswith("position uncertain: 1 sigma is 0.0")
    filter_.events[-1].P[:] = np.nan
    assert filter_.lost_reason(1990 * MS).startswith("position uncertain: 1 sigma is nan m")


# --- publication of the state, and problems -------------------------------------------------------

BEGIN, INTERVAL = 500_000 * MS, 25 * MS
AT_REST = (0.1, 0.2, 0.3)


def tracked(filter_=None):
    filter_, states = filter_ or BodyFilter(), []
    return TrackedBody(filter_, filter_.update_pose, states.append), states


def test_each_accepted_pose_is_published():
    body, states = tracked()
    assert body.lost_reason == "not observed yet"
    for k in range(20):
        body.update_pose(BEGIN + k * 10 * MS, AT_REST)
    times = [BEGIN + k * 10 * MS for k in range(3, 20)]  # the speed is unknown before
    assert [state.t for state in states] == times
    np.testing.assert_allclose(states[-1].pose, AT_REST, atol=1e-6)
    assert not body.lost_reason
    body.update_pose(BEGIN + 200 * MS, (5.0, 5.0, 0.0))  # an outlier
    assert len(states) == len(times)


def test_a_prediction_is_published_once_poses_are_missing_and_until_it_is_unknown():
    body, states = tracked()
    for k in range(20):
        body.update_pose(BEGIN + k * 10 * MS, AT_REST)
        body.publish_if_due(BEGIN + k * 10 * MS + 5 * MS, INTERVAL, body.filter.predict)
    measured = len(states)
    for k in range(20, 1000):
        body.publish_if_due(BEGIN + k * 10 * MS, INTERVAL, body.filter.predict)
    assert np.diff([state.t for state in states[measured:]]).min() > INTERVAL
    assert 100 * MS < states[-1].t - body.filter.last_pose_time <= 2000 * MS
    assert body.lost_reason


def test_problems_and_values_of_a_new_navigation():
    navigation = Navigation(paper_arm())
    base, target = tracked(navigation.base)[0], tracked(navigation.target)[0]
    bodies = navigation, base, target
    assert find_problems(*bodies, BEGIN) == [
        "base not observed yet",
        "readings of a joint are missing: motion of the arm unknown",
    ]
    values = diagnostic_values(*bodies, 3, {"fog/imu from the future": 2})
    assert (values["base"], values["pulses received"]) == ("not observed yet", 3)
    assert values["fog/imu from the future"] == 2
    assert "gyro bias [rad/s]" not in values
    for i in range(4):
        navigation.add_joint_reading(i, BEGIN, 0.1, 0.0)
    for k in range(60):
        base.update_pose(BEGIN + k * 10 * MS, AT_REST)
    now = BEGIN + 600 * MS
    assert find_problems(*bodies, now) == [
        "no gyro: heading from motion capture only",
        "readings of a joint are missing: motion of the arm unknown",
    ]
    assert find_problems(*bodies, now, ["fog/imu"])[2:] == [
        "stamps of fog/imu are in the future: clocks differ, or the test bed is too slow"
    ]
    late = find_problems(*bodies, now + 990 * MS)
    assert late[0] == "base predicted, not observed for 1.0 s"
    values = diagnostic_values(*bodies, 0, {})
    assert (values["base"], values["filter restarts"]) == ("known", 0)
    assert "gyro bias [rad/s]" in values


def test_faulty_valves_are_numbered_from_one():
    assert valve_problems(Faults(frozenset({2}), frozenset({0, 7}), True)) == [
        "valve 3 does not close",
        "valve 1 does not open",
        "valve 8 does not open",
        "an unknown force pushes the base",
    ]
