"""Publication of a body's state, and the problems that diagnostics report."""

import numpy as np

from fss_arm_model.description import paper_arm
from fss_gnc.navigation import BodyFilter, Navigation
from fss_gnc.navigation.health import diagnostic_values, find_problems, valve_problems
from fss_gnc.navigation.tracked_body import TrackedBody
from fss_gnc.navigation.valve_faults import Faults

START, MS = 500_000_000_000, 1_000_000  # [ns]
INTERVAL = 25 * MS
AT_REST = (0.1, 0.2, 0.3)


def track(filter_=None):
    filter_, states = filter_ or BodyFilter(), []
    return TrackedBody(filter_, filter_.update_pose, states.append), states


def test_each_accepted_pose_is_published():
    body, states = track()
    assert body.lost_reason == "not observed yet"
    for k in range(20):
        body.update_pose(START + k * 10 * MS, AT_REST)
    times = [START + k * 10 * MS for k in range(3, 20)]  # the speed is unknown before
    assert [state.t for state in states] == times
    np.testing.assert_allclose(states[-1].pose, AT_REST, atol=1e-6)
    assert not body.lost_reason
    body.update_pose(START + 200 * MS, (5.0, 5.0, 0.0))  # an outlier
    assert len(states) == len(times)


def test_a_prediction_is_published_once_poses_are_missing_and_until_it_is_unknown():
    body, states = track()
    for k in range(20):
        body.update_pose(START + k * 10 * MS, AT_REST)
        body.publish_if_due(START + k * 10 * MS + 5 * MS, INTERVAL, body.filter.predict)
    measured = len(states)
    for k in range(20, 1000):
        body.publish_if_due(START + k * 10 * MS, INTERVAL, body.filter.predict)
    assert np.diff([state.t for state in states[measured:]]).min() > INTERVAL
    assert 100 * MS < states[-1].t - body.filter.last_pose_time <= 2000 * MS
    assert body.lost_reason


def test_problems_and_values_of_a_new_navigation():
    navigation = Navigation(paper_arm())
    base, target = track(navigation.base)[0], track(navigation.target)[0]
    bodies = navigation, base, target
    assert find_problems(*bodies, START) == [
        "base not observed yet",
        "readings of a joint are missing: motion of the arm unknown",
    ]
    values = diagnostic_values(*bodies, 3, {"fog/imu from the future": 2})
    assert (values["base"], values["pulses received"]) == ("not observed yet", 3)
    assert values["fog/imu from the future"] == 2
    assert "gyro bias [rad/s]" not in values
    for i in range(4):
        navigation.add_joint_reading(i, START, 0.1, 0.0)
    for k in range(60):
        base.update_pose(START + k * 10 * MS, AT_REST)
    now = START + 600 * MS
    assert find_problems(*bodies, now) == [
        "no gyro: heading from motion capture only",
        "readings of a joint are missing: motion of the arm unknown",
    ]
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
