"""What goes wrong in laboratories is named first, and nothing else, on bags that MuJoCo made."""

from itertools import product

import numpy as np
import pytest
from foreign_bags import arm, described, flight, heard, make, write
from laboratory_errors import DYNAMIC, KINEMATIC, ORDER, SIGN, SWAPPED, Kind

from fss_arm_calib import causes
from fss_arm_calib.acceptance import CAUSE, PASS
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.result import read_passed
from fss_arm_model.description_file import from_yaml, save
from fss_arm_model.parameters import parameter_names, values
from fss_arm_model.planar import wrap

#: Of three links, what is tried without --slow; the others are of bench_causes.py: four minutes.
QUICK = [
    *(
        ("kinematic", name)
        for name in ("one sign", "clock set", "no stamps", "end effector turned", "another gear")
    ),
    *(("dynamic", name) for name in ("gyro in degrees", "end effector frozen", "base held")),
]


def cases():
    """A kind of calibration, what is spoilt for it, and a number of links."""
    for calibration, spoilt in (("kinematic", KINEMATIC), ("dynamic", DYNAMIC)):
        for kind, n in product(spoilt, (3, 6)):
            quick = n == 3 and (calibration, kind.name) in QUICK
            marks = [] if quick else [pytest.mark.slow]
            name = f"{calibration} {kind.name} {n}"
            yield pytest.param(calibration, kind, n, id=name, marks=marks)


def solved(folder, n, dynamic, kind=None, noise=0, seed=1):
    bag, description = make(folder, n, seed, dynamic, kind and kind.spoil, noise)
    calibration = KINDS["dynamic" if dynamic else "kinematic"]
    options = kind.options if kind else {}
    return solve_bag(calibration, bag, calibration.settings(arm=str(description), **options))


def accused(outcome):
    return [check.reason for check in outcome.checks if check.name == CAUSE]


@pytest.mark.parametrize(("calibration", "kind", "n"), [*cases()])
def test_the_cause_is_named_first_and_not_applied(calibration, kind, n, tmp_path):
    outcome = solved(tmp_path, n, calibration == "dynamic", kind)
    assert outcome.verdict != PASS
    assert kind.named(outcome.reasons, n), outcome.reasons
    assert outcome.description == ""
    assert len(accused(outcome)) <= 1


@pytest.mark.parametrize("dynamic", [False, True])
@pytest.mark.parametrize(
    ("n", "count"),
    [(3, 1), *(pytest.param(n, 20, marks=pytest.mark.slow) for n in (3, 6))],
)
def test_good_bags_of_unlike_links_pass_by_default_and_accuse_nobody(dynamic, n, count, tmp_path):
    """bench_causes.py makes fifty; twenty take two minutes."""
    for k in range(count):
        seed = 1 + k % 5
        outcome = solved(tmp_path / str(k), n, dynamic, noise=1 + k, seed=seed)
        assert outcome.verdict == PASS, (k, outcome.reasons)
        assert not accused(outcome)
        assert not outcome.solution.noise.is_given.any()
        found = from_yaml(outcome.description)
        for one, true in zip(found.links, arm(n, seed).links, strict=True):
            assert abs(one.a - true.a) < 0.001 * n


def test_two_mistakes_at_once_are_not_explained_by_one_and_the_search_ends(tmp_path, monkeypatch):
    def both(what, rng):
        SIGN.spoil(what, rng)
        SWAPPED.spoil(what, rng)

    outcome = solved(tmp_path / "both", 3, False, Kind("both", "", both))
    assert outcome.verdict != PASS
    assert not accused(outcome)
    monkeypatch.setattr(causes, "MAX_SEARCH_TIME", -1.0)
    assert not accused(solved(tmp_path / "sign", 3, False, SIGN))


def test_another_arms_data_are_called_so(tmp_path):
    """No hypothesis makes its links longer."""
    bag, _ = make(tmp_path, 3, 1, False)
    other = described(arm(3, 1), 1, False)
    lengths = [link.a + 0.09 for link in other.links]
    other = other.with_kinematics(
        [*lengths, *(link.theta_0 for link in other.links[1:]), *other.base.mount]
    )
    save(other, tmp_path / "other.yaml")
    kind = KINDS["kinematic"]
    outcome = solve_bag(kind, bag, kind.settings(arm=str(tmp_path / "other.yaml")))
    assert outcome.verdict != PASS
    assert outcome.reasons[0].startswith("another arm's data: a_")
    assert not any("residuals are larger" in reason for reason in outcome.reasons)


def test_frames_that_differ_are_told_of_a_pass(tmp_path):
    what = heard(flight(3, 1, False), 1001, False)
    what.frames["end_effector"] = "vicon"
    _, description = make(tmp_path, 3, 1, False, noise=1)
    kind = KINDS["kinematic"]
    outcome = solve_bag(kind, write(tmp_path / "own", what), kind.settings(arm=str(description)))
    assert outcome.verdict == PASS
    words = "poses are in different frames: fss in 'world' and end_effector in 'vicon'"
    assert words in outcome.reasons


def test_the_verdict_is_printed_in_the_first_line_with_the_cause(tmp_path, capsys):
    bag, description = make(tmp_path, 3, 1, False, ORDER.spoil)
    assert from_bag([str(bag), "--arm", str(description)]) == 2
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("fail: ")
    assert "swapped? swapped back, the residuals are" in said[:160]


def test_a_mistake_that_the_tape_does_not_hold_is_not_sought(tmp_path):
    """By settings that cannot be met: nothing heard explains it."""
    bag, description = make(tmp_path, 3, 1, False)
    kind = KINDS["kinematic"]
    outcome = solve_bag(kind, bag, kind.settings(arm=str(description), min_observations=40))
    assert outcome.verdict != PASS
    assert not accused(outcome)
    assert np.isnan(outcome.values).all()


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 6])
def test_a_joint_estimate_is_within_what_is_claimed(n, tmp_path):
    """By what drawings tell, with all other settings as they are."""
    bag, description = make(tmp_path, n, 1, True)
    truth, result = arm(n, 1), tmp_path / "joint.json"
    save(described(truth, 1, False), description)
    asked = ["--arm", str(description), "--result", str(result)]
    assert from_bag(["--joint", str(bag), *asked]) == 0
    found = read_passed(result, "joint")
    assert tuple(found["names"]) == parameter_names(n)
    off = np.array(found["values"]) - values(truth)
    angles = np.array(found["units"]) == "rad"
    off[angles] = wrap(off[angles])
    assert np.abs(off / found["deviations"]).max() < 4.0
    assert off @ np.linalg.solve(found["covariance"], off) / len(off) < 2.0
    assert max(found["deviations"][3 * n + 6 : 4 * n + 6]) < 0.006  # b
