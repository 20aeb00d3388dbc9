"""The command `plan`, and the files it writes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fss_arm_model.description import paper_arm
from fss_arm_model.files import ContentError
from fss_arm_motion.kinds import KINDS
from fss_arm_motion.plan import PlanError, Start
from fss_arm_motion.plan_command import main
from fss_arm_motion.plan_file import digest, parsed, plan_from_file, written
from fss_arm_motion.point_to_point import PointToPoint, point_to_point


@pytest.fixture(scope="module")
def made():
    start = Start(paper_arm(), np.zeros(4), covariance=np.eye(32) * 1e-6)
    return start, point_to_point(start, PointToPoint((0.3, -0.2, 0.1, 0.4)))


@pytest.fixture(scope="module")
def text(made):
    return written(*made)


def test_what_is_written_is_read_back(made, text):
    (start, plan), stored = made, parsed(text)
    assert (stored.arm, stored.digest) == ("paper", digest(start.arm))
    assert stored.plan.kind == "point_to_point"
    assert stored.plan.arguments["goal"] == [0.3, -0.2, 0.1, 0.4]
    for name in ("times", "q", "qd", "used"):
        assert_allclose(getattr(stored.plan, name), getattr(plan, name), rtol=1e-8, atol=1e-12)
    for name in ("times", "pose", "deviation"):
        ours = getattr(stored.plan.prediction, name)
        assert_allclose(ours, getattr(plan.prediction, name), rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(
    ("was", "becomes", "words"),
    [
        ("version: 1", "version: 2", "version is 2, expected 1"),
        ("kind: point_to_point", "kind: [1]", r"kind is \[1\], expected a kind of plan"),
        ("time: [0.0,", "time: [0.1,", "knots: time is .*, expected two or more, ascending from 0"),
        ("  qd:", "  rates:", "knots: qd is missing"),
        ("- [0.0, 0.0, 0.0, 0.0]", "- [0.0, 0.0, 0.0]", "knots: q.* expected finite numbers"),
        ("- [0.0, 0.0, 0.0, 0.0]", "- [.nan, 0.0, 0.0, 0.0]", "knots: q.* expected finite numbers"),
        ("arm: {name: paper", "arm: {title: paper", "arm: name is missing"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line_that_names_the_entry(text, was, becomes, words):
    assert was in text
    with pytest.raises(ContentError, match=words) as error:
        parsed(text.replace(was, becomes, 1))
    assert "\n" not in str(error.value)


def test_a_plan_from_a_file_starts_where_the_arm_is(tmp_path, text):
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    drifting = Start(paper_arm(), np.array([0.01, 0.0, 0.0, 0.0]), momentum=np.array([1.0, 0, 0]))
    plan = plan_from_file(path, drifting, 0.02)
    assert plan.prediction.pose[-1, 0] > parsed(path).plan.prediction.pose[-1, 0]
    with pytest.raises(PlanError, match=f"joint 1 is at 0.57 deg, {path} starts at 0.00 deg"):
        plan_from_file(path, drifting, 0.005)
    arm = replace(paper_arm(), links=paper_arm().links[:3])
    with pytest.raises(PlanError, match=f"{path} is for 4 joints, the arm has 3"):
        plan_from_file(path, Start(arm, np.zeros(3)), 0.02)


EXAMPLES = {
    "point_to_point": "--goal 20 -30 10 40",
    "zero_reaction": "--q -30 40 30 20 --direction 1 0 0 0",
    "reorientation": "--angle 15",
    "tip_path": "--q -50 55 45 40 --by -0.2 -0.1",
    "best_posture": "--direction 45 --place 0.9 0.3",
}


def test_the_report_states_the_change_of_the_base_and_the_limit(capsys):
    options = f"point_to_point {EXAMPLES['point_to_point']} --pose 1 0 30"
    assert main(options.split()) == 0
    _, limit, change, _, *_ = capsys.readouterr().out.splitlines()
    share = r"\d+ % of what plans may use \(90 % of the drive's(, less friction)?\)"
    kind = r"(rate|acceleration|torque) of joint \d"
    assert re.fullmatch(rf"closest to a limit: {kind}, {share}", limit)
    number = r"(-?\d+\.\d+) ± (\d+\.\d+)"
    names = rf"x {number} mm, y {number} mm, heading {number} deg"
    found = re.fullmatch(rf"change of the base \(± 1 sigma\): {names}", change)
    assert max(abs(float(value)) for value in found.groups()) < 100.0  # not the pose


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_writes_its_path_and_its_figure(kind, tmp_path, capsys):
    path, figure = tmp_path / "path.yaml", tmp_path / "new" / "plan.png"
    args = f"{kind} {EXAMPLES[kind]} --output {path} --figure {figure}"
    assert main(args.split()) == 0
    assert kind.replace("_", " ") in capsys.readouterr().out
    plan = parsed(path).plan
    assert plan.kind == kind
    if kind == "point_to_point":
        assert_allclose(plan.q[-1], np.radians([20, -30, 10, 40]))
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ("point_to_point --goal 0 0 0 100", "joint 4 at 100 deg, expected -90 to 90 deg"),
        ("point_to_point --goal 10 0 0 0 --share 0", "share is 0.0, expected above 0, at most 1"),
        ("point_to_point --goal 10 0 0 0 --arm unknown", "arm is 'unknown'"),
        ("tip_path", "by and through: neither given"),
        ("zero_reaction --direction 0 0 0 0", "expected 4 numbers, not all 0"),
        ("reorientation --angle 0", "angle is 0 rad (0 deg), expected -pi to pi, and not 0"),
        ("best_posture --place 5 5", "place is [5.0, 5.0] m"),
    ],
)
def test_a_wrong_wish_ends_with_one_line(args, words, capsys):
    assert main(args.split()) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("args", ["", "dance", "point_to_point --goal north"])
def test_a_wrong_command_line_ends_with_one_line(args, capsys):
    with pytest.raises(SystemExit) as end:
        main(args.split())
    assert end.value.code == 1
    assert capsys.readouterr().err.count("\n") == 1
