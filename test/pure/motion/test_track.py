"""Measured drift before a motion, and motion during it."""

import numpy as np
import pytest

from fss_arm_model.units import SECOND
from fss_arm_motion.track import Track


def track(rng, twist, seconds=4.0, begin=1_700_000_000 * SECOND, noise=3e-4):
    track = Track(angle=2)
    for k in range(round(100 * seconds)):
        x, y, heading = np.multiply(twist, 0.01 * k) + noise * rng.standard_normal(3)
        track.add(begin + k * SECOND // 100, (x, y, (heading + np.pi) % (2 * np.pi) - np.pi))
    return track, begin


def test_a_drift_is_found_to_a_fraction_of_a_millimetre_a_second():
    twist = np.array([0.01, -0.02, 2.0])  # the heading wraps
    found, begin = track(np.random.default_rng(0), twist)
    end = begin + 3 * SECOND
    drift = found.drift(end, 2.0)
    # sigma sqrt(12 / N) / T for the slope of N poses in T, and 2 sigma / sqrt(N) at its end.
    sigma = 3e-4 * np.sqrt(12 / 200) / 2.0
    np.testing.assert_allclose(drift.rate, twist, atol=4 * sigma)
    np.testing.assert_allclose(drift.at, 3.0 * twist, atol=4 * 2 * 3e-4 / np.sqrt(200))
    moved, excursion = found.moved(begin, end)
    np.testing.assert_allclose(moved, 3.0 * twist, atol=2e-3)
    assert excursion[2] == pytest.approx(6.0, abs=2e-3)


def test_a_drift_is_known_as_well_as_it_says():
    twist, squares = np.zeros(3), []
    for seed in range(300):
        found, begin = track(np.random.default_rng(seed), twist, seconds=2.0)
        drift = found.drift(begin + 2 * SECOND, 2.0)
        squares.append(drift.rate**2 / np.diag(drift.covariance))
    # Student's t of 6 degrees of freedom, whose square has a mean of 1.5; 900 of them.
    assert np.mean(squares) == pytest.approx(1.5, abs=0.35)


def test_what_was_not_seen_is_not_known():
    found, begin = track(np.random.default_rng(0), np.zeros(3))
    assert found.drift(begin + 10 * SECOND, 2.0) is None
    assert found.drift(begin + SECOND // 2, 2.0) is None
    assert found.moved(begin, begin + 5 * SECOND) is None


def test_stamps_that_go_back_begin_anew():
    found, begin = track(np.random.default_rng(0), np.zeros(3))
    found.add(begin, (1.0, 2.0, 3.0))
    assert found.between(0, 2 * begin)[1].tolist() == [[1.0, 2.0, 3.0]]


def test_of_one_time_the_last_estimate_counts():
    track = Track(angle=2)
    for k in range(20):
        track.add(k * SECOND // 10, (0.1 * k, 0.0, 0.0))
        track.add(k * SECOND // 10, (0.2 * k, 0.0, 0.0))
    moved, _ = track.moved(0, SECOND)
    np.testing.assert_allclose(moved, [2.0, 0.0, 0.0], atol=1e-12)
