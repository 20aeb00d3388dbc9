"""Noise estimated from residuals: as large as it was, as well known as said, given if given."""

from dataclasses import replace

import numpy as np
import pytest
from calib_rests import ARM, observe, shifted

from fss_arm_calib.acceptance import FAIL, PASS
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_model.estimation.noise import Noise, ResidualSums, solve_with_noise
from fss_arm_model.layout import kinematic_index

CAMERA = np.array([0.001, 0.001, np.radians(0.1)])
UNLIKE = ARM.with_kinematics([0.42, 0.30, 0.37, 0.25, 0.1, -0.06, -0.02, 0.2, 0.02, 0.3])
SETTINGS = KinematicSettings(parametrization="full")


def test_errors_are_as_large_as_claimed_of_a_camera_that_nobody_described():
    truth, nees, off = ARM.vector()[kinematic_index(4)], [], []
    for seed in range(100):
        found = calibrate(observe(sigma=CAMERA, seed=seed), ARM, SETTINGS)
        assert found.verdict == PASS, found.reason
        error, noise = found.values - truth, found.solution.noise
        nees.append(error @ np.linalg.solve(found.covariance, error) / len(error))
        off.append((noise.deviations - CAMERA[1:]) / noise.uncertainty)
    assert np.mean(nees) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(np.square(off), axis=0)) == pytest.approx([1.15, 1.15], abs=0.2)
    assert (found.deviations < 0.003).all()  # with the paper's camera, up to 0.01


def test_what_is_given_is_assumed():
    s = replace(SETTINGS, position_deviation=0.002)
    noise = calibrate(observe(sigma=CAMERA), ARM, s).solution.noise
    assert noise.deviations[0] == 0.002
    assert noise.is_given.tolist() == [True, False]
    assert noise.deviations[1] == pytest.approx(CAMERA[2], rel=0.6)


def test_more_than_is_believed_of_a_camera_fails_as_if_assumed():
    found = calibrate(observe(sigma=60.0 * CAMERA), ARM, SETTINGS)
    given = replace(
        SETTINGS,
        position_deviation=SETTINGS.max_position_deviation,
        heading_deviation=SETTINGS.max_heading_deviation,
    )
    assert found.verdict == FAIL
    assert "residuals are larger than the assumed deviations allow" in found.reason
    assert np.array_equal(found.values, calibrate(observe(sigma=60.0 * CAMERA), ARM, given).values)


def test_of_too_few_nothing_is_estimated():
    found = calibrate(observe(sigma=CAMERA, q=DEFAULT_POSTURES[:6]), ARM, SETTINGS)
    assert found.estimate.degrees_of_freedom == 8
    assert not found.solution.noise.is_given.any()
    few = replace(SETTINGS, parametrization="offsets", min_observations=2)
    assert calibrate(
        observe(sigma=CAMERA, q=DEFAULT_POSTURES[:2]), ARM, few
    ).solution.noise.is_given.all()


def test_one_far_off_is_named_though_it_makes_the_noise_larger():
    seen = observe(sigma=CAMERA, seed=3)
    seen[4] = shifted(seen[4], 0.012)
    found = calibrate(seen, ARM, SETTINGS)
    assert found.verdict == FAIL
    assert "observation 5 inconsistent" in found.reason
    assert calibrate(seen, ARM, replace(SETTINGS, max_outliers=1)).verdict == PASS


def test_unlike_links_are_told_apart_unless_asked_not_to():
    seen = observe(sigma=CAMERA, arm=UNLIKE)
    equal = calibrate(seen, UNLIKE, KinematicSettings(parametrization="equal"))
    assert equal.verdict == FAIL
    assert "another arm's data, or links described as 0.300 to 0.420 m long" in equal.reason
    assert "--parametrization full separates them" in equal.reason


def test_two_kinds_of_coordinates_have_their_own_noise():
    true = np.array([0.004, 0.0005])
    s = replace(SETTINGS, max_position_deviation=0.01, max_heading_deviation=0.01)

    def solve(deviations):
        return None, ResidualSums((true / deviations) ** 2 * [30.0, 20.0], np.array([32.0, 22.0]))

    noise = solve_with_noise(s, solve).noise
    assert noise.deviations == pytest.approx(true)
    assert noise.uncertainty == pytest.approx(true / np.sqrt([64.0, 44.0]))


def test_more_than_expected_is_said_to_be_within_chance():
    """A stranger reads it beside `pass`."""
    noise = Noise(np.array([0.023, 0.01]), np.array([0.004, 0.0]), np.array([0.0177, 0.1]), 20.0)
    assert (
        str(noise) == "23 ± 4 mm (17.7 mm assumed; the excess is not significant) and 0.57 degrees"
    )
    less = replace(noise, deviations=np.array([0.012, 0.01]))
    assert str(less) == "12 ± 4 mm (at most 17.7 mm assumed) and 0.57 degrees"
