"""What the data do not determine is named, and each advice of a message can be typed as it is."""

import json
import re
import shlex

import numpy as np
import pytest
from foreign_bags import COARSE, arm, make

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_model.parameters import parameter_names, values

DYNAMIC = KINDS["dynamic"]
WITHOUT_INERTIAS = "m_i m_0 I_0 com_0 a_i theta_0_i mount"
OPTION = re.compile(r"--[a-z-]+ (?:'[^']*'|[^\s;,)]+)")


def advised(text):
    """The options that a message says, as a shell reads them."""
    return [word for option in OPTION.findall(text) for word in shlex.split(option)]


@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 4, 6, 8))])
def test_arms_of_unlike_links_pass_by_default_and_name_what_was_not_measured(n, tmp_path):
    """With the worst cameras that are accepted; each inertia is described to a quarter."""
    squares, count, lost = 0.0, 0, 0
    for seed in (1, 2, 3):
        bag, description = make(tmp_path / str(seed), n, seed, True, None, seed, COARSE)
        outcome = solve_bag(DYNAMIC, bag, DYNAMIC.settings(arm=str(description)))
        assert outcome.verdict == PASS, outcome.reason
        true = dict(zip(parameter_names(n), values(arm(n, seed)), strict=True))
        finite = np.isfinite(outcome.deviations)
        known = [k for k, name in enumerate(outcome.names) if name in true and finite[k]]
        off = np.array([outcome.values[k] - true[outcome.names[k]] for k in known])
        assert np.abs(off / outcome.deviations[known]).max() < 5.0
        C = outcome.covariance[np.ix_(known, known)]
        squares, count = squares + off @ np.linalg.solve(C, off), count + len(off)
        left = outcome.estimate.unmeasured
        lost += len(left)
        assert set(left) == {name for name, it in zip(outcome.names, finite, strict=True) if not it}
        assert {name[0] for name in left} <= {"I"}
        if left:
            assert f"which is accepted: {', '.join(left)} (to require" in outcome.reason
            assert "(not determined)" in outcome.summary
    assert 0 < lost < 3 * n
    print(f"{n} links: NEES {squares / count:.2f}, {lost} of {3 * n} inertias not determined")
    assert squares / count < 1.6  # of 26 numbers or more; priors are wider than errors


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Of an arm whose inertias are not all seen."""
    return make(tmp_path_factory.mktemp("three"), 3, 3, True, None, 3, COARSE)


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    """Of an arm with an inertia that a fit without its prior puts to 0."""
    return make(tmp_path_factory.mktemp("six"), 6, 2, True, None, 2, COARSE)


def solved(bag, description, *options):
    """Verdict and reason of what `from_bag` writes."""
    file = description.with_name("result.json")
    from_bag(["--dynamic", str(bag), "--arm", str(description), "--result", str(file), *options])
    found = json.loads(file.read_text())
    return found["verdict"], found["reason"]


@pytest.mark.parametrize(
    ("links", "given", "says"),
    [
        ("three", ["--max-relative", "0.25"], "too uncertain: I_1 not determined"),
        ("three", ["--max-relative", "0.1", "--max-place", "0.004"], "too uncertain: .*b_2"),
        ("six", ["--priors", WITHOUT_INERTIAS], "at a physical bound: I_3"),
        ("three", ["--estimate", "m_i b_i I_i", "--priors", ""], "cannot be determined"),
    ],
)
def test_an_advice_typed_as_it_is_leads_to_a_pass(links, given, says, request):
    bag, description = request.getfixturevalue(links)
    verdict, reason = solved(bag, description, *given)
    assert verdict != PASS
    assert re.search(says, reason), reason
    while verdict != PASS:
        options = advised(reason)
        assert options, reason
        given, before = [*given, *options], reason
        verdict, reason = solved(bag, description, *given)
        assert reason != before


def test_design_says_what_it_will_not_tell_and_how_to_plan_for_it(three, capsys):
    given, lost = ["--arm", str(three[1]), "--count", "2"], []
    for _ in range(4):
        assert design(given) == 0
        (line,) = re.findall(r"\d+ maneuvers? determine .*", capsys.readouterr().out)
        lost.append(re.findall(r"I_\d", line.partition(", not ")[2].partition(":")[0]))
        given += advised(line)
    assert lost[0] == ["I_1", "I_2", "I_3"]
    assert lost[-1] in (["I_1"], [])
