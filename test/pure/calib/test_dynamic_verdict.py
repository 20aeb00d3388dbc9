"""What is concluded from maneuvers: pass, fail and not_evaluated, each with its reason."""

import re
from dataclasses import replace

import numpy as np
import pytest
from calib_float import ARM, Float, postures
from calib_rig import feed

from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.dynamic.settings import HEADING, DynamicSettings
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description_file import from_yaml
from fss_arm_model.layout import BASE_SIZE, LINK_SIZE
from fss_arm_ros.calibrated import Calibrated

STATE = np.array([0.1, 0.2, 3.0, 0.2, -0.1, 0.03, 0.0002, -0.0001])
SETTINGS = DynamicSettings(position_deviation=0.0005, heading_deviation=0.0017)


@pytest.fixture(scope="module")
def maneuvers():
    """Sixteen of them, seen with the errors that the settings assume."""
    noise = SETTINGS.position_deviation, SETTINGS.heading_deviation
    return feed(ManeuverFinder(4), Float(postures(16, seed=5), None, STATE, 5.2, noise).samples(20))


@pytest.fixture(scope="module")
def good(maneuvers):
    return calibrate(maneuvers, ARM, SETTINGS)


def test_a_good_calibration_passes_and_gives_the_next_description(good):
    assert good.verdict == PASS, good.reason
    assert good.accepted == 16
    for name, value, deviation, truth in zip(
        good.names, good.values, good.deviations, good.estimate.initial, strict=True
    ):
        if name not in ("g_x", "g_y"):
            assert abs(value - truth) < 4.0 * deviation, name
    arm = from_yaml(good.description)
    assert arm.links[1].b == good.values[1]
    assert arm.base.inertia == good.values[8]
    assert arm.links[1].a == ARM.links[1].a
    assert 0.5 < good.estimate.chi_square / good.estimate.degrees_of_freedom < 1.5
    found = np.array([good.estimate.position_residual, good.estimate.heading_residual])
    given = np.array([SETTINGS.position_deviation, SETTINGS.heading_deviation])
    assert found == pytest.approx(given / 5**0.5, rel=0.2)


def test_the_description_says_where_it_is_from(good):
    comments = [line for line in good.description.splitlines() if line.startswith("# ")]
    assert re.search(
        r"Calibrated by fss_arm_calib .* from live data, until (\d{4}-\d\d-\d\d|\d+ s of)",
        comments[1],
    )
    assert re.search(r"pass: 16 maneuvers, chi-square of the fit [\d.]+ for [\d.]+ d", comments[2])
    k = good.names.index("I_2")
    said = f"# I_2 = {good.values[k]:.6g} +- {good.deviations[k]:.2g} kg m^2"
    assert said in comments


def test_others_take_what_passed(good):
    """The description with its covariance, without the table's tilt."""
    known = Calibrated(ARM).with_message("calibration/dynamic", DYNAMIC.to_message(good, "fss"))
    assert known.arm == from_yaml(good.description)
    i = BASE_SIZE + LINK_SIZE + 3  # I_2
    expected = good.deviations[good.names.index("I_2")]
    assert np.sqrt(known.covariance[i, i]) == pytest.approx(expected)


def test_what_can_be_told_is_told(good):
    found, message = good.solution, DYNAMIC.to_message(good, "fss")
    assert len(found.directions) == len(good.names)
    assert "invisible" not in [d.kind for d in found.directions]
    assert list(message.combinations) == [c.name for c in found.combinations]
    assert list(message.bias) == found.result.bias.ravel().tolist()


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_maneuvers_are_not_evaluated_and_have_no_numbers(maneuvers, count):
    few = calibrate(maneuvers[:count], ARM, SETTINGS, Streams(silent=("fss",)))
    assert few.verdict == NOT_EVALUATED
    assert f"{count} maneuvers, at least 6 needed; nothing received from fss" in few.reason
    assert np.isnan(few.values).all()
    assert few.description == ""
    DYNAMIC.to_message(few, "fss")


def test_parameters_that_cannot_be_told_apart_are_not_evaluated(maneuvers):
    settings = replace(SETTINGS, estimate="m_i b_i I_i", priors="")
    result = calibrate(maneuvers, ARM, settings)
    assert result.verdict == NOT_EVALUATED
    assert "m_1, m_2, m_3, m_4, b_1" in result.reason
    assert "3 combinations undetermined" in result.reason
    assert "3 invisible to any maneuver" in result.reason
    assert np.isnan(result.values[:12]).all()
    assert np.isinf(result.deviations[:12]).all()
    assert np.isfinite([c.deviation for c in result.solution.combinations]).all()
    assert [d.kind for d in result.solution.directions].count("invisible") == 3


def test_larger_errors_than_assumed_fail(maneuvers):
    result = calibrate(maneuvers, ARM, replace(SETTINGS, heading_deviation=0.0005))
    assert result.verdict == FAIL
    assert "residuals are larger than the deviations allow" in result.reason


def test_what_is_asked_of_precision_is_told(maneuvers):
    result = calibrate(maneuvers, ARM, replace(SETTINGS, max_place=0.001))
    assert result.verdict == FAIL
    assert "too uncertain: b_" in result.reason
    assert re.search(
        r"\(at most 1 mm\): record more, or accept it with --max-place 0.0\d+$", result.reason
    )


def test_a_link_too_light_to_be_seen_is_said_to_be_so():
    """Its inertia is a hundredth of the others', which nobody can see: it is no other arm."""
    light = replace(ARM, links=(*ARM.links[:3], replace(ARM.links[3], mass=0.15, inertia=3e-4)))
    noise = SETTINGS.position_deviation, SETTINGS.heading_deviation
    rig = Float(postures(8, seed=6), light.vector(), STATE, noise=noise)
    result = calibrate(feed(ManeuverFinder(4), rig.samples(20)), light, SETTINGS)
    assert result.verdict == PASS, result.reason
    assert (
        "not determined, which is accepted: I_1, I_4 (to require them: --max-relative 0.25)"
        in result.reason
    )
    k = result.names.index("I_4")
    assert result.deviations[k] == np.inf
    assert np.sqrt(result.covariance[k, k]) == pytest.approx(0.5 * 3e-4, rel=0.1)
    assert f"# I_4 = {result.values[k]:.6g} kg m^2, not determined" in result.description
    assert DYNAMIC.to_message(result, "fss").calibration.undetermined == ["I_1", "I_4"]
    table = DYNAMIC.report_of(result, light).tables[0]
    assert {"I_1, not determined", "I_4, not determined"} <= {table.rows[k][0] for k in table.weak}
    required = calibrate(result.used, light, replace(SETTINGS, max_relative=0.25))
    assert required.verdict == FAIL
    assert re.search("too uncertain: .*I_4 not determined", required.reason)


def test_momenta_said_to_be_large_do_not_make_the_fit_lenient(maneuvers):
    """They were known to be small: no more is allowed of the poses if much is allowed of them."""
    fits = []
    for times in (1.0, 100.0):
        momenta = {"momentum_deviation": 0.3 * times, "spin_deviation": 0.05 * times}
        settings = replace(SETTINGS, min_probability=0.0, **momenta)
        left = calibrate(maneuvers, ARM, settings).solution.nominal.residual_sums
        fits.append(np.sum(left.squares) / np.sum(left.freedom))
    assert fits[0] == pytest.approx(fits[1], rel=0.03)


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (57.3, "gyro in degrees per second? the gyro measures 57.3 times"),
        (-1.0, "gyro with the wrong sign?"),
        (1.5, "the gyro measures 1.5 times the turn that motion capture measures"),
        (1.1, ""),
        (np.nan, ""),
    ],
)
def test_a_gyro_that_turns_otherwise_fails(maneuvers, ratio, words):
    result = calibrate(maneuvers, ARM, SETTINGS, Streams(gyro_ratio=ratio))
    assert result.verdict == (FAIL if words else PASS)
    assert not words or result.reasons[0].startswith(words)


def test_a_pass_says_why_the_end_effector_was_not_compared(maneuvers):
    unseen = [replace(one, tip=()) for one in maneuvers]
    lost = Streams(rejected={"end_effector out of range": 812, "fss jump": 1})
    result = calibrate(unseen, ARM, SETTINGS, lost)
    assert result.verdict == PASS
    words = "end effector not compared with the description: 812 end_effector out of range"
    assert f"{words}; in millimeters?" in result.reasons


def test_velocities_in_degrees_per_second_fail_and_missing_ones_do_not(maneuvers):
    for factor, verdict in ((57.3, FAIL), (-1.0, FAIL), (1.2, PASS), (0.0, PASS)):
        rates = [[[factor * x for x in qd] for qd in one.qd] for one in maneuvers]
        some = [replace(one, qd=qd) for one, qd in zip(maneuvers, rates, strict=True)]
        result = calibrate(some, ARM, SETTINGS)
        assert (result.reasons[0].startswith("joint velocities ")) == (verdict == FAIL)


def test_headings_alone_as_in_the_paper(maneuvers):
    settings = replace(SETTINGS, estimate="I", residuals=HEADING)
    result = calibrate(maneuvers, ARM, settings)
    assert result.names == ("I", "g_x", "g_y")
    assert np.isnan(result.estimate.position_residual)
    assert abs(result.values[0] - 0.034) < 4.0 * result.deviations[0]


def test_maneuvers_of_another_arm_are_refused(maneuvers):
    with pytest.raises(ValueError, match="a maneuver is of 4 joints, expected 3"):
        calibrate(maneuvers, replace(ARM, links=ARM.links[:3]), SETTINGS)
