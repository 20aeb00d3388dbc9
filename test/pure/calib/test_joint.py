"""One arm from all data of several sessions: the truth, what is claimed, and what tells it."""

from dataclasses import replace

import numpy as np
import pytest
from calib_joint import ARM, SETTINGS, SURROUNDINGS, day, draw_arm, errors, nees
from numpy.testing import assert_allclose

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.joint.calibrate import Session, calibrate, problem_of
from fss_arm_calib.joint.problem import solve
from fss_arm_calib.joint.report import joint_report
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES
from fss_arm_model.description_file import from_yaml
from fss_arm_model.parameters import values

JOINT = JointSettings(zero_deviation=0.02)


def problem(days, guess=ARM, settings=JOINT):
    return problem_of([one.data for one in days], guess, settings, JOINT_SOURCES, SETTINGS)


def test_deviations_that_nobody_gave_are_those_that_the_stages_found():
    """As well known as by the true ones, not as the largest that would be believed."""
    unsaid = {"position_deviation": 0.0, "heading_deviation": 0.0}
    settings = {
        name: one if name == "drift" else replace(one, **unsaid) for name, one in SETTINGS.items()
    }
    rng = np.random.default_rng(5)
    sessions = [Session("day", day(draw_arm(rng), rng).data)]
    given, found = (
        np.sqrt(np.diag(calibrate(sessions, ARM, JOINT, JOINT_SOURCES, known).estimate.covariance))
        for known in (SETTINGS, settings)
    )
    assert_allclose(found, given, rtol=0.6)


@pytest.mark.parametrize(
    ("seeds", "bounds"),
    [
        (range(5), (0.25, 0.04)),  # the mean of 5 trials of 26 parameters has a deviation of 0.12
        pytest.param(range(1000, 1500), (0.05, 0.02), marks=pytest.mark.slow),
    ],
)
def test_errors_are_as_large_as_claimed(seeds, bounds):
    """Everything uncertain, and other zeros, tilt and hose on each of two days."""
    found = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = draw_arm(rng)
        known = problem([day(truth, rng, zeros=0.02), day(truth, rng, number=1)])
        result = solve(known, bounded=False)
        assert result.minimum.converged
        squared = nees(known.names, result.values, result.covariance, truth)
        found.append((squared, result.minimum.cost / known.degrees_of_freedom))
    squared, chi_square = np.mean(found, axis=0)
    print(f"NEES {squared:.3f} a parameter, chi-square {chi_square:.3f} a degree of freedom")
    assert squared == pytest.approx(1.0, abs=bounds[0])
    assert chi_square == pytest.approx(1.0, abs=bounds[1])


@pytest.fixture(scope="module")
def two():
    """A truth, two days of it, and their problem."""
    rng = np.random.default_rng(7)
    truth = draw_arm(rng)
    days = [day(truth, rng, (10, 8, 2), 0.02, 0), day(truth, rng, (10, 8, 2), 0.0, 1)]
    return truth, days, problem(days)


def test_what_sessions_have_for_their_own_is_found(two):
    _, days, known = two
    result = solve(known)
    assert known.session_names(0) == (
        *("theta_0_2", "theta_0_3", "theta_0_4", "theta_BJ1"),
        *("g_x", "g_y", "torque", "twist_damping", "drag"),
    )
    assert known.session_names(1) == known.session_names(0)[4:]
    for k, one in enumerate(days):
        found, sigma = result.session(k)
        true = one.acting if k else [*one.moved[1:], one.moved[0], *one.acting]
        assert (np.abs(found - true) < 4.0 * sigma).all()
        assert (sigma < known.session_deviations(k)).all()
    assert (sigma[:2] < 0.1 * SURROUNDINGS[:2]).all()  # drifts tell a table's tilt


def test_what_is_eliminated_is_where_the_sum_of_squares_is_least(two):
    """By the sum of squares of all unknowns alone, however it is minimized."""
    _, _, known = two
    found = solve(known, bounded=False).minimum
    p, rng, N = len(known.names), np.random.default_rng(0), np.linalg.inv(found.basis.covariance())
    for _ in range(5):
        dx = 1e-3 * np.sqrt(np.diag(found.basis.covariance())) * rng.standard_normal(p)
        there = found.x + found.linear.extend(dx)
        least = known.linearize(there).cost
        assert least - found.cost == pytest.approx(dx @ N @ dx, rel=0.01)
        # Any other unknowns beside the same dx make it larger, either way alike.
        aside = np.concatenate([np.zeros(p), 1e-6 * rng.standard_normal(len(there) - p)])
        up, down = (known.linearize(there + sign * aside).cost - least for sign in (1.0, -1.0))
        assert min(up, down) > 0.0
        assert up == pytest.approx(down, rel=0.05)


def test_what_told_a_parameter_is_told(two):
    """Lengths come from rests, inertias from maneuvers, and tilt mostly from drifts."""
    _, _, known = two
    result = solve(known)
    grown = {
        kind: dict(zip(known.names, sigma / np.sqrt(np.diag(result.covariance)), strict=True))
        for kind, sigma in result.without.items()
    }
    assert set(grown) == {"kinematic", "dynamic", "drift"}
    assert min(ratio for one in grown.values() for ratio in one.values()) > 1.0 - 1e-9
    assert grown["kinematic"]["a_2"] > 5.0 > 1.5 > grown["dynamic"]["a_2"]
    assert grown["dynamic"]["I_4"] > 5.0
    assert np.isinf(grown["kinematic"]["a_4"])  # nobody else sees the end effector


def test_joints_that_keep_their_zeros_tell_more(two):
    truth, _, _ = two
    rng = np.random.default_rng(8)
    days = [day(truth, rng, (10, 8, 2), 0.0, k) for k in range(2)]
    sigma = [
        np.sqrt(np.diag(solve(problem(days, settings=replace(JOINT, zero_deviation=z))).covariance))
        for z in (0.0, 0.02)
    ]
    named = dict(zip(problem(days).names, sigma[0] / sigma[1], strict=True))
    assert named["theta_0_3"] < 0.85
    assert max(named.values()) < 1.0 + 1e-5


def test_from_the_stages_to_a_description(two):
    truth, days, _ = two
    sessions = [Session(f"day_{k}", one.data) for k, one in enumerate(days)]
    outcome = calibrate(sessions, ARM, JOINT, JOINT_SOURCES, SETTINGS)
    assert outcome.verdict == PASS, outcome.reason
    assert "20 observations, 16 maneuvers, 4 drifts of 2 sessions" in outcome.reason
    arm = from_yaml(outcome.description)
    assert_allclose(values(arm), outcome.values, rtol=0, atol=1e-12)
    assert arm.known.names == outcome.names
    assert_allclose(np.diag(arm.known.covariance), outcome.deviations**2, rtol=1e-9)
    assert errors(outcome.names, outcome.values, truth)[:4] == pytest.approx(0.0, abs=0.2)
    text = str(joint_report(outcome, truth))
    for words in ("x without dynamic", "Residuals by kind", "twist_damping", "day_1"):
        assert words in text


def test_a_session_is_split_where_a_joint_was_homed(two):
    truth, _, _ = two
    rng = np.random.default_rng(9)
    first, second = day(truth, rng, (8, 6, 1), 0.02, 0), day(truth, rng, (8, 6, 1), 0.0, 1)
    data = {
        kind: [
            replace(one, boots=(1,) * 4, homings=(k,) * 4) if kind == "kinematic" else one
            for k, some in enumerate((first, second), 1)
            for one in some.data[kind]
        ]
        for kind in first.data
    }
    outcome = calibrate([Session("week", data)], ARM, JOINT, JOINT_SOURCES, SETTINGS)
    assert outcome.solution.sessions == ("week, homed 0 times", "week, homed 1 time")
    assert outcome.verdict == PASS, outcome.reason
    found, sigma = outcome.solution.result.session(0)
    assert (np.abs(found[:4] - [*first.moved[1:], first.moved[0]]) < 4.0 * sigma[:4]).all()


def test_rests_alone_leave_masses_undetermined(two):
    _, days, _ = two
    alone = [Session("rests", {"kinematic": days[1].data["kinematic"]})]
    outcome = calibrate(alone, ARM, JOINT, JOINT_SOURCES, SETTINGS)
    assert outcome.verdict == "not_evaluated"
    assert set(outcome.estimate.undetermined) == {f"b_{i}" for i in range(1, 5)}
    assert outcome.estimate.unmeasured == tuple(f"I_{i}" for i in range(1, 5))
    a = outcome.names.index("a_1")
    assert 0.0 < outcome.deviations[a] < 0.01
    assert outcome.description == ""
    table = joint_report(outcome).tables[0]
    assert {table.rows[k][0] for k in table.weak} >= set(outcome.estimate.undetermined)
    assert a not in table.weak
    nothing = calibrate([], ARM, JOINT, JOINT_SOURCES, SETTINGS)
    assert nothing.verdict == "not_evaluated"
    assert nothing.reason == "no rest, maneuver or drift can be used"
