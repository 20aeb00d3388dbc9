"""One wrong datum of each kind: it is named, rejected by choice, or weighs little."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from calib_joint import ARM, SETTINGS, SURROUNDINGS, drifts, maneuvers, rests
from calib_rests import shifted

from fss_arm_calib.acceptance import FAIL, PASS
from fss_arm_calib.kinds import KINDS

RNG = np.random.default_rng(4)
DATA = {
    "kinematic": rests(ARM, 13, RNG),
    "dynamic": maneuvers(ARM, 12, RNG, SURROUNDINGS),
    "drift": drifts(ARM, 4, RNG, SURROUNDINGS),
}
WRONG = 2  # of the data


def turned_at_the_end(maneuver):
    x, y, heading = maneuver.poses[-1]
    return replace(maneuver, poses=(*maneuver.poses[:-1], (x, y, heading + 0.02)))


def pushed(drift):
    """Return the drift with a step of 5 mm in the middle."""
    half = len(drift.poses) // 2
    poses = [(x + 0.005 * (k > half), y, h) for k, (x, y, h) in enumerate(drift.poses)]
    return replace(drift, poses=tuple(poses))


SPOIL = {
    "kinematic": partial(shifted, x=0.02, y=-0.01),
    "dynamic": turned_at_the_end,
    "drift": pushed,
}


def calibrate(kind, data, **settings):
    return KINDS[kind].calibrate(data, ARM, replace(SETTINGS[kind], **settings))


@pytest.fixture(params=SPOIL)
def kind(request):
    return request.param


@pytest.fixture
def wrong(kind):
    data = list(DATA[kind])
    data[WRONG] = SPOIL[kind](data[WRONG])
    return data


def test_it_is_named_and_fails(kind, wrong):
    found = calibrate(kind, wrong)
    assert found.verdict == FAIL
    assert found.description == ""
    (check,) = (check for check in found.checks if check.name == "outliers")
    assert check.verdict == FAIL
    what = rf"{KINDS[kind].data.noun}s? {WRONG + 1}\b.* inconsistent: largest normalized "
    assert re.match(what, check.reason), check.reason
    assert np.argmax(found.estimate.errors) == WRONG
    assert kind != "drift" or "another force moved the base" in found.reason


def test_it_is_rejected_by_choice_as_if_it_had_never_been_there(kind, wrong):
    found = calibrate(kind, wrong, max_outliers=1)
    assert found.verdict == PASS, found.reason
    assert found.accepted == len(wrong) - 1
    assert len(found.used) == len(wrong)
    expected = np.arange(len(wrong)) != WRONG
    assert found.estimate.weights.tolist() == expected.tolist()
    assert [not reason for reason in found.estimate.reasons] == expected.tolist()
    assert f"{KINDS[kind].data.noun} {WRONG + 1} rejected (at most 1)" in found.reason
    without = calibrate(kind, [*wrong[:WRONG], *wrong[WRONG + 1 :]])
    np.testing.assert_array_equal(found.values, without.values)
    assert calibrate(kind, DATA[kind], max_outliers=1).accepted == len(wrong)


def test_it_weighs_little_by_a_robust_loss(kind, wrong):
    found = calibrate(kind, wrong, loss="cauchy")
    assert np.argmin(found.estimate.weights) == WRONG
    assert found.estimate.weights[WRONG] < 0.5


@pytest.mark.parametrize("kind", ["kinematic", "dynamic"], indirect=True)
def test_none_is_rejected_of_what_is_needed(kind, wrong):
    """Two are off, and seven data have but one to spare."""
    some = [*wrong[:5], SPOIL[kind](wrong[5]), wrong[6]]
    found = calibrate(kind, some, max_outliers=3)
    assert found.accepted == 6
    assert sum(map(bool, found.estimate.reasons)) == 1
