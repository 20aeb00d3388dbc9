"""From one calibration to the next with all that is known, and what it costs to forget it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from calib_joint import (
    ARM,
    DRIFT,
    DYNAMIC,
    KINEMATIC,
    ROUGH,
    SURROUNDINGS,
    draw_arm,
    drifts,
    dynamics,
    errors,
    forgotten,
    kinematics,
    maneuvers,
    nees,
    rests,
)
from numpy.testing import assert_allclose

from fss_arm_calib import result
from fss_arm_calib.acceptance import PASS
from fss_arm_calib.drift.calibrate import body_deviations
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_model.description import Known
from fss_arm_model.description_fields import DescriptionError
from fss_arm_model.description_file import from_yaml, to_yaml
from fss_arm_model.files import ContentError
from fss_arm_model.layout import kinematic_names
from fss_arm_model.parameters import parameter_names, values
from fss_arm_model.units import SECOND
from fss_arm_ros.calibrated import Calibrated, with_kinematics_of

DAY = 86_400 * SECOND
ALONG = "b_i I_i I_0 com_0 a_i theta_0_i mount"
MASSES = [f"{kind}_{i}" for kind in "bI" for i in range(1, 5)] + ["I_0", "x_com", "y_com"]


def world(seed):
    """Random numbers, a true arm, and what acts on it."""
    rng = np.random.default_rng(seed)
    return rng, draw_arm(rng), SURROUNDINGS * rng.standard_normal(5)


def chain(seed, rough):
    """NEES a parameter of b, I and the base by a chain from rests to maneuvers."""
    rng, truth, acting = world(seed)
    seen = ROUGH if rough else KINEMATIC
    arm = kinematics(rests(truth, 13, rng, s=seen), s=seen)
    found = dynamics(maneuvers(truth, 16, rng, acting), arm, replace(DYNAMIC, estimate=ALONG))
    at = [found.problem.names.index(name) for name in MASSES]
    return nees(MASSES, found.values[at], found.covariance[np.ix_(at, at)], truth)


@pytest.mark.parametrize(
    ("rough", "seeds", "bound"),
    [
        (True, range(6), 0.35),
        pytest.param(False, range(2000, 2500), 0.1, marks=pytest.mark.slow),
        pytest.param(True, range(2000, 2500), 0.1, marks=pytest.mark.slow),
    ],
)
def test_masses_are_as_uncertain_as_claimed_by_a_chain(rough, seeds, bound):
    """Cameras see the base well; rough: and the end effector at rest as the paper's do."""
    found = np.mean([chain(seed, rough) for seed in seeds])
    print(f"NEES {found:.3f} a parameter")
    assert found == pytest.approx(1.0, abs=bound)


@pytest.fixture(scope="module")
def told():
    """A truth, its rests, maneuvers, and the outcome of both calibrations in a chain."""
    rng, truth, acting = world(1)
    found = calibrate(rests(truth, 13, rng), ARM, KINEMATIC)
    some = maneuvers(truth, 16, rng, acting)
    arm = from_yaml(found.description)
    return truth, found, calibrate_dynamics(some, arm, replace(DYNAMIC, estimate=ALONG))


def test_a_description_tells_the_covariance_of_what_was_found(told):
    _, found, dynamic = told
    arm = from_yaml(found.description)
    assert arm.known.names == found.names == kinematic_names(4)
    assert_allclose(arm.known.covariance, found.covariance, rtol=1e-12, atol=0)
    assert Calibrated(arm).covariance[8, 8] == pytest.approx(found.covariance[0, 0])
    heavier = replace(ARM, base=replace(ARM.base, mass=12.0))
    both = with_kinematics_of(arm, heavier)
    assert (both.base.mass, both.known, both.links[1].a) == (12.0, arm.known, arm.links[1].a)
    assert from_yaml(to_yaml(arm)) == arm
    after = from_yaml(dynamic.description)
    assert set(after.known.names) == set(parameter_names(4))
    C = after.known.covariance_of(dynamic.names[:-2], np.zeros(len(dynamic.names) - 2))
    assert_allclose(C, dynamic.covariance[:-2, :-2], rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(20), marks=pytest.mark.slow)])
def test_all_parameters_together_are_as_uncertain_as_a_dynamic_result_says(seeds):
    """Those assumed too: with what errors of theirs have moved."""
    found = []
    for seed in seeds:
        rng, truth, acting = world(seed)
        arm = kinematics(rests(truth, 13, rng))
        r = dynamics(maneuvers(truth, 16, rng, acting), arm)
        every = dict(zip(parameter_names(4), values(arm), strict=True))
        every |= dict(zip(r.problem.names, r.values, strict=True))
        known = r.updated_knowledge
        C = np.array(known.covariance)
        found.append(nees(known.names, [every[name] for name in known.names], C, truth))
    assert np.mean(found) == pytest.approx(1.0, abs=0.2)


def test_knowledge_of_masses_counts_unless_it_is_from_data_of_the_same_time(told):
    truth, _, dynamic = told
    rng, arm = np.random.default_rng(2), from_yaml(dynamic.description)
    assert (arm.known.begin, arm.known.end) == (dynamic.provenance.begin, dynamic.provenance.end)
    more = maneuvers(truth, 12, rng, SURROUNDINGS * rng.standard_normal(5))
    later = [replace(one, start=one.start + DAY, end=one.end + DAY) for one in more]
    alone, together = (calibrate_dynamics(some, arm, DYNAMIC) for some in (more, later))
    known = arm.known.only(kinematic_names(4))
    without = calibrate_dynamics(more, replace(arm, known=known), DYNAMIC)
    assert_allclose(alone.covariance, without.covariance, rtol=1e-9)
    assert together.verdict == PASS, together.reason
    b = [together.names.index(f"b_{i}") for i in range(1, 5)]
    assert (together.deviations[b] < alone.deviations[b]).all()
    assert np.mean(together.deviations[b] / alone.deviations[b]) < 0.85
    at = [together.names.index(name) for name in MASSES]
    away = errors(MASSES, together.values[at], truth) / together.deviations[at]
    assert np.abs(away).max() < 3.5


def test_times_without_any_known_value_are_not_written(told):
    arm = from_yaml(told[2].description)
    text = to_yaml(replace(arm, known=arm.known.only(())))
    assert "known" not in text
    assert from_yaml(text).known == Known()


def test_offsets_alone_are_as_uncertain_as_the_lengths_that_are_kept():
    """After a homing: lengths come from a rough calibration of before."""
    found, blind = [], []
    offsets = replace(KINEMATIC, parametrization="offsets")
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = draw_arm(rng)
        arm, later = kinematics(rests(truth, 13, rng, s=ROUGH), s=ROUGH), rests(truth, 6, rng)
        for before, into in ((arm, found), (forgotten(arm), blind)):
            after = calibrate(later, before, offsets)
            into.append(nees(after.names, after.values, after.covariance, truth))
    assert np.mean(found) == pytest.approx(1.0, abs=0.4)
    assert np.mean(blind) > 3.0


def test_drifts_know_the_whole_as_well_as_the_description_tells(told):
    truth, _, dynamic = told
    some = drifts(truth, 2, np.random.default_rng(0), SURROUNDINGS)
    com, mass = body_deviations(some, from_yaml(dynamic.description), DRIFT)
    assert 1e-4 < com < 0.5 * DRIFT.com_deviation
    assert 1e-3 < mass < DRIFT.mass_deviation
    assert body_deviations(some, ARM, DRIFT) == (DRIFT.com_deviation, DRIFT.mass_deviation)


def test_a_result_as_files(told, tmp_path):
    _, found, dynamic = told
    path = tmp_path / "out" / "kinematic.json"
    result.write(path, "kinematic", found)
    read = json.loads(path.read_text())
    assert read["schema"] == result.SCHEMA
    assert read["verdict"] == "pass"
    assert read["names"] == list(found.names)
    assert_allclose(read["covariance"], found.covariance, rtol=0, atol=0)
    assert read["fit"]["chi_square"] == found.estimate.chi_square
    assert read["provenance"]["data_hash"] == found.provenance.data_hash
    assert result.read_arm(path, "kinematic") == from_yaml(found.description)
    head, first, *_ = path.with_suffix(".csv").read_text().splitlines()
    assert head.split(",")[:6] == ["name", "unit", "initial", "value", "deviation", "a_1"]
    assert float(first.split(",")[3]) == found.values[0]
    with pytest.raises(ContentError, match="kind is 'kinematic', expected dynamic"):
        result.read_arm(path, "dynamic")
    result.write(path, "dynamic", dynamic)
    assert json.loads(path.read_text())["time_offset"] is None  # not known


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "other/1"}, "schema is 'other/1', expected fss_arm_calib/result/1"),
        ({"verdict": "fail"}, "verdict is 'fail', expected pass"),
        ({"description": "name: [1"}, "expected"),
    ],
)
def test_a_result_that_cannot_be_begun_from_is_refused(told, tmp_path, change, message):
    path = tmp_path / "result.json"
    result.write(path, "kinematic", told[1])
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ContentError, match=message):
        result.read_arm(path, "kinematic")


@pytest.mark.parametrize(
    ("names", "rows", "message"),
    [
        (["a_1", "a_1"], [[1.0, 0.0], [0.0, 1.0]], "names is .* expected a list of names"),
        (["a_1", "a_2"], [[1.0]], "covariance is 'of 1 values', expected of 2"),
        (["a_1", "a_2"], [[1.0, 0.5], [0.4, 1.0]], "expected a symmetric matrix"),
        (["a_1"], [[-1.0]], "expected a symmetric matrix whose diagonal is 0 or more"),
        (["a_1"], [[float("nan")]], "expected as many rows"),
    ],
)
def test_an_impossible_covariance_is_refused(names, rows, message):
    with pytest.raises(DescriptionError, match=message):
        Known(tuple(names), rows)
