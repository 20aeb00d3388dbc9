"""The start of a plan from measured states, reasons why none can start, and measured drift."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.momentum import momentum
from fss_arm_model.units import SECOND
from fss_arm_motion.measured import Measured, MotionError
from fss_arm_motion.settings import MotionSettings
from fss_arm_motion.track import Track
from fss_arm_ros.calibrated import Calibrated

ARM, CALIBRATED = paper_arm(), Calibrated(paper_arm())
BEGIN = 1_700_000_000 * SECOND
NOISE = 3e-4  # of poses [m], [rad]
Q = (0.1, -0.2, 0.3, -0.4)


def measured(seconds=6.0, twist=(0.01, -0.02, 0.03), qd=(0.0,) * 4, base=True):
    """Return the state after joints and base have been measured at 20 Hz, and the time [ns]."""
    found, t = Measured(MotionSettings()), BEGIN
    for k in range(round(20 * seconds) + 1):
        t = BEGIN + k * SECOND // 20
        found.add_joints(t, [(i, Q[i - 1], qd[i - 1], 0.0) for i in (3, 1, 4, 2)])  # unsorted
        if base:
            found.base.add(t, tuple(0.05 * k * np.array(twist)))
    return found, t


def test_the_start_has_the_momentum_of_the_drifting_base():
    found, now = measured()
    assert found.has_base
    start = found.start(now, CALIBRATED)
    pose, twist = 6.0 * np.array([0.01, -0.02, 0.03]), np.array([0.01, -0.02, 0.03])
    np.testing.assert_allclose(start.q, Q)
    np.testing.assert_allclose(start.pose, pose, atol=1e-9)
    expected = momentum(ARM.vector(), [*pose, *Q], [*twist, *np.zeros(4)])
    np.testing.assert_allclose(start.momentum, expected, atol=1e-9)
    assert start.state_covariance.shape == (6, 6)


def test_a_base_without_poses_is_assumed_at_rest():
    found, now = measured(base=False)
    assert not found.has_base
    start = found.start(now, CALIBRATED)
    assert not start.pose.any()
    assert not start.momentum.any()
    assert start.state_covariance is None


@pytest.mark.parametrize(
    ("joints", "age", "words"),
    [
        (None, 0.0, "arm/joint_states was not received yet: check that arm and all links run"),
        (4, 1.5, "arm/joint_states is 1.5 s old: check that arm and all links run"),
        (3, 0.0, "arm/joint_states has 3 joints, the description 4"),
    ],
)
def test_without_the_state_of_all_joints_no_motion_starts(joints, age, words):
    found = Measured(MotionSettings())
    if joints:
        found.add_joints(BEGIN, [(i, 0.0, 0.0, 0.0) for i in range(1, joints + 1)])
    with pytest.raises(MotionError, match=f"^{words}$"):
        found.start(BEGIN + round(age * SECOND), CALIBRATED)


def test_no_motion_starts_while_a_joint_moves():
    found, now = measured(qd=(0.0, 0.005, -0.2, 0.0))
    with pytest.raises(MotionError, match=r"joint 3 moves at -0.200 rad/s; wait until"):
        found.start(now, CALIBRATED)


def test_it_has_rested_one_window_after_the_last_motion():
    found, now = measured(seconds=0.0, qd=(0.2, 0.0, 0.0, 0.0))
    for seconds, rested in ((0.0, False), (3.9, False), (4.0, True)):
        found.add_joints(now + round(seconds * SECOND), [(1, 0.0, 0.009, 0.0)])
        assert found.has_rested is rested


# --- measured drift before a motion, and motion during it -----------------------------------------


def noisy_track(rng, twist, seconds=4.0):
    track = Track(angle=2)
    for k in range(round(100 * seconds)):
        x, y, heading = np.multiply(twist, 0.01 * k) + NOISE * rng.standard_normal(3)
        track.add(BEGIN + k * SECOND // 100, (x, y, (heading + np.pi) % (2 * np.pi) - np.pi))
    return track


def test_a_drift_is_found_to_a_fraction_of_a_millimetre_a_second():
    twist = np.array([0.01, -0.02, 2.0])  # the heading wraps
    found = noisy_track(np.random.default_rng(0), twist)
    end = BEGIN + 3 * SECOND
    drift = found.drift(end, 2.0)
    # NOISE sqrt(12 / N) / T for the slope of N poses in T, and 2 NOISE / sqrt(N) at its end.
    slope_sigma = NOISE * np.sqrt(12 / 200) / 2.0
    np.testing.assert_allclose(drift.rate, twist, atol=4 * slope_sigma)
    np.testing.assert_allclose(drift.at, 3.0 * twist, atol=4 * 2 * NOISE / np.sqrt(200))
    moved, excursion = found.moved(BEGIN, end)
    np.testing.assert_allclose(moved, 3.0 * twist, atol=2e-3)
    assert excursion[2] == pytest.approx(6.0, abs=2e-3)


def test_the_covariance_of_a_drift_is_consistent():
    twist, squares = np.zeros(3), []
    for seed in range(300):
        found = noisy_track(np.random.default_rng(seed), twist, seconds=2.0)
        drift = found.drift(BEGIN + 2 * SECOND, 2.0)
        squares.append(drift.rate**2 / np.diag(drift.covariance))
    # Student's t of 6 degrees of freedom, whose square has a mean of 1.5; 3 sigma of 900.
    assert np.mean(squares) == pytest.approx(1.5, abs=0.35)


def test_without_enough_poses_there_is_no_drift():
    found = noisy_track(np.random.default_rng(0), np.zeros(3))
    assert found.drift(BEGIN + 10 * SECOND, 2.0) is None
    assert found.drift(BEGIN + SECOND // 2, 2.0) is None
    assert found.moved(BEGIN, BEGIN + 5 * SECOND) is None


def test_an_older_stamp_resets_the_track():
    found = noisy_track(np.random.default_rng(0), np.zeros(3))
    found.add(BEGIN, (1.0, 2.0, 3.0))
    assert found.between(0, 2 * BEGIN)[1].tolist() == [[1.0, 2.0, 3.0]]


def test_the_last_of_equal_stamps_is_kept():
    track = Track(angle=2)
    for k in range(20):
        track.add(k * SECOND // 10, (0.1 * k, 0.0, 0.0))
        track.add(k * SECOND // 10, (0.2 * k, 0.0, 0.0))
    moved, _ = track.moved(0, SECOND)
    np.testing.assert_allclose(moved, [2.0, 0.0, 0.0], atol=1e-12)
