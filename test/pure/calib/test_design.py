"""Proposed maneuvers: they keep to their conditions, and tell more than others."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml

from fss_arm_calib.dynamic.identifiability import information, propagate_covariance
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.design import (
    candidates,
    design,
    expected_result,
    meets_goal,
    parse_goal,
    predicted_problem,
)
from fss_arm_calib.experiment.design_command import main
from fss_arm_calib.experiment.planned import plan_to_yaml, read_plan
from fss_arm_calib.experiment.settings import LOOP, SINGLE, SWEEP, Conditions, ExperimentSettings
from fss_arm_model.base_motion import base_poses
from fss_arm_model.description import Link, paper_arm
from fss_arm_model.files import ContentError
from fss_arm_model.free_floating import free_torques
from fss_arm_model.joint_path import path
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.straight_moves import PAUSE, TORQUE_SHARE, speed_profile

ARM = paper_arm()
SETTINGS = DynamicSettings()
SMALL = {"tried": 15, "seed": 1}


def some(kind, count=25, **conditions):
    given = Conditions(kinds=(kind,), **conditions)
    return candidates(ARM, np.zeros(4), count, given, np.random.default_rng(2))


@pytest.mark.parametrize("kind", [SINGLE, SWEEP, LOOP])
def test_candidates_keep_to_the_conditions(kind):
    found = some(kind, duration=7.0)
    assert len(found) > 10
    s, rate, acceleration = (x[:, None] for x in speed_profile(np.linspace(0.001, 0.999, 97)))
    for one in found:
        law, edges = one.law()
        t = np.linspace(0.0, one.length, 50)
        q, qd = law(t)
        assert one.length <= 7.0
        assert np.abs(q).max() <= np.pi / 2
        assert (np.abs(qd).max(axis=0) <= 1.0 + 1e-9).all()
        for a, b, T in zip(one.waypoints[:-1], one.waypoints[1:], one.durations, strict=True):
            way = b - a
            tau = free_torques(
                ARM.vector(), a + s * way, rate * way / T, acceleration * way / T**2
            )[0]
            assert np.abs(tau).max() <= 1.02 * TORQUE_SHARE * 1.8
        poses = base_poses(ARM.vector(), path(law, edges, t), np.zeros(8))
        places = joint_positions(ARM.vector(), np.concatenate([poses, q], axis=1))
        assert np.abs(places).max() < 2.0
        moving = np.abs(np.diff(one.waypoints, axis=0)).max(axis=0) > 0.0
        if kind == SINGLE:
            assert np.count_nonzero(moving) == 1
        if kind == LOOP:
            assert np.array_equal(one.waypoints[0], one.waypoints[-1])


def test_laws_go_through_the_waypoints_and_rest_between():
    (one, *_) = (p for p in some(SWEEP) if len(p.durations) == 2)
    law, _ = one.law()
    arrival = one.durations[0]
    q, qd = law(np.array([0.0, arrival, arrival + 0.5 * PAUSE, one.length]))
    assert q[[0, 1, 3]] == pytest.approx(one.waypoints, abs=1e-12)
    assert np.array_equal(q[1], q[2])
    assert np.abs(qd).max() < 1e-9


@pytest.mark.slow
def test_a_design_tells_more_than_chance_and_is_the_same_for_a_seed():
    plan = design(ARM, 6, SETTINGS, **SMALL)
    again = design(ARM, 6, SETTINGS, **SMALL)
    assert plan_to_yaml(plan) == plan_to_yaml(again)
    for one, following in pairwise(plan):
        assert np.array_equal(one.waypoints[-1], following.waypoints[0])

    def volume(maneuvers):
        covariance = expected_result(ARM, maneuvers, SETTINGS, 5.0).random
        return np.linalg.slogdet(covariance)[1]

    chances = [design(ARM, 6, SETTINGS, tried=3, seed=k) for k in range(5)]
    assert volume(plan) < np.mean(list(map(volume, chances))) - 1.0


def test_expected_deviations_are_those_of_the_solver():
    plan = design(ARM, 6, SETTINGS, **SMALL)
    result = expected_result(ARM, plan, SETTINGS, 5.0)
    assert result.values[0] == pytest.approx(0.191, abs=1e-9)
    assert result.minimum.iterations == 0
    model = predicted_problem(ARM, plan, SETTINGS, 5.0)
    prior = np.diag(
        np.where(np.isfinite(model.prior_deviations), model.prior_deviations, np.inf) ** -2.0
    )
    total, p = information(model).sum(axis=0), len(prior)
    covariance = np.linalg.inv(total[:p, :p] + prior)
    assert result.random == pytest.approx(covariance, rel=1e-6)
    assert propagate_covariance(model, total) == pytest.approx(result.covariance, rel=1e-6)


def test_chosen_parameters_come_first():
    """In as much time, where CAD tells something of all others."""
    known, time = replace(SETTINGS, priors="b_i I_i I_0 com_0"), Conditions(total=50.0)
    everything = design(ARM, 50, known, time, **SMALL)
    last = design(ARM, 50, known, time, chosen=["b_4", "I_4"], **SMALL)
    assert 35.0 < sum(p.length + 5.0 for p in everything) + 5.0 <= 50.0  # the floating time

    def of_link_4(plan):
        result = expected_result(ARM, plan, known, 5.0)
        which = [result.problem.names.index(name) for name in ("b_4", "I_4")]
        return np.linalg.slogdet(result.covariance[np.ix_(which, which)])[1]

    assert of_link_4(last) < of_link_4(everything)
    with pytest.raises(ValueError, match="m_1 is not estimated"):
        design(ARM, 1, SETTINGS, chosen=["m_1"], **SMALL)


def test_what_is_known_already_is_not_sought_again():
    first = design(ARM, 4, SETTINGS, **SMALL)
    before = predicted_problem(ARM, first, SETTINGS, 5.0)
    begin = first[-1].waypoints[-1]
    following = design(ARM, 4, SETTINGS, before=before, begin=begin, tried=15, seed=2)
    anew = design(ARM, 4, SETTINGS, begin=begin, tried=15, seed=2)

    def both(plan):
        after = expected_result(ARM, plan, SETTINGS, 5.0, before).covariance
        together = expected_result(ARM, [*first, *plan], SETTINGS, 5.0).covariance
        assert after == pytest.approx(together, rel=1e-6)
        return np.linalg.slogdet(after)[1]

    assert both(following) <= both(anew) + 1e-9


def test_a_plan_of_another_arm_is_read_back(tmp_path):
    link = Link(a=0.3, theta_0=0.0, mass=2.0, inertia=0.02, b=0.15)
    plan, path = design(replace(ARM, links=(link, link)), 3, SETTINGS, **SMALL), tmp_path / "plan"
    path.write_text(plan_to_yaml(plan))
    for one, again in zip(plan, read_plan(path, 2), strict=True):
        assert again.kind == one.kind
        assert again.waypoints == pytest.approx(one.waypoints, abs=1e-6)
        assert again.durations == pytest.approx(one.durations, abs=1e-3)


def test_joints_are_excited_one_by_one(tmp_path):
    path = tmp_path / "plan.yaml"
    assert main(["--kinds", "joint", "--repeats", "1", "--output", str(path)]) == 0
    plan = read_plan(path, 4)
    assert len(plan) == 8
    for one in plan:
        assert np.count_nonzero(np.ptp(one.waypoints, axis=0)) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "line 2 is .*, expected YAML"),
        ("hello: 1", "maneuvers is missing, expected rows of kind, q and durations"),
        ("maneuvers: [{kind: a}]", "maneuvers is .*, expected rows of kind, q and durations"),
        ("maneuvers: [{kind: a, q: [[0, 0]], durations: []}]", r"maneuver 1 is .*\(w \+ 1, 4\)"),
    ],
)
def test_what_is_no_plan_is_named(tmp_path, text, message):
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    with pytest.raises(ContentError, match=f"plan.yaml: {message}"):
        read_plan(path, 4)


def test_a_goal_is_kept_to_with_as_few_maneuvers_as_it_takes(tmp_path, capsys):
    output, asked = tmp_path / "plan.yaml", ["--kinds", "sweep", "--goal"]
    given = "--count", "12", "--rest", "9", "--output", str(output)
    assert main([*asked, "b_4 0.02", *given]) == 0
    assert "goal b_4 0.02: promised" in capsys.readouterr().out
    plan = read_plan(output, 4)
    assert 1 < len(plan) < 12
    goal = {"b_4": 0.02}
    assert meets_goal(expected_result(ARM, plan, SETTINGS, 9.0), goal)
    assert not meets_goal(expected_result(ARM, plan[:-1], SETTINGS, 9.0), goal)  # it was needed
    assert main([*asked, "b_i 0.0001", "--count", "2"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    words = r"goal b_i 0.0001: not met by 2 maneuvers: b_\d reaches .*, .* of it because \w+ is"
    assert re.search(words, text)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("b_i 0.002", {"b_1": 0.002, "b_10": 0.002}),
        ("I_i 0.1 I_0 2", {"I_1": 0.1, "I_0": 2.0}),
        ("", {}),
    ],
)
def test_a_goal_in_words(words, found):
    assert parse_goal(words, ("b_1", "b_10", "I_1", "I_0", "x_com")) == found


@pytest.mark.parametrize("words", ["b_i", "b_i x", "c_i 1", "b_1 -1", "0.1 b_1"])
def test_a_goal_that_cannot_be_is_refused(words):
    expected = r"goal has .* expected (a name and a dev|one of b_1 I_0)"
    with pytest.raises(ValueError, match=expected):
        parse_goal(words, ("b_1", "I_0"))
    if words == "b_i":
        with pytest.raises(ValueError, match=expected):  # before anything moves
            ExperimentSettings(goal=words)


def test_the_command_prints_what_to_expect_and_writes_a_plan(tmp_path, capsys):
    output = tmp_path / "plan.yaml"
    assert main(["--count", "2", "--kinds", "single", "--output", str(output)]) == 0
    text = capsys.readouterr().out
    for words in ("Expected result", "± 1 sigma", "b_1", "single", "plan written to"):
        assert words in text
    assert len(read_plan(output, 4)) == 2
    assert main(["--kinematic", "--count", "8", "--output", str(output)]) == 0
    assert "theta_BJ1" in capsys.readouterr().out
    parameters = yaml.safe_load(output.read_text())["/**/experiment"]["ros__parameters"]
    assert np.shape(parameters["postures"]) == (32,)
    assert main(["--table", "1", "1", "--count", "1"]) == 1
    error = capsys.readouterr().err
    assert re.search("keeps to 8 s, .* and a table of 1 x 1 m", error)
    assert error.count("\n") == 1
