"""The next experiment from what is known: of a bag, of a result; and what came of its promise."""

import numpy as np
import pytest
import yaml
from calib_float import ARM, Float, postures
from calib_rig import record

from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.result import read_passed
from fss_arm_model.description_file import save

SEEN = ["--position-deviation", "0.0005", "--heading-deviation", "0.001"]
MAX = ["--max-relative", "2"]


@pytest.fixture(scope="module")
def monday(tmp_path_factory):
    """A bag of ten maneuvers, the arm's description and the result."""
    folder = tmp_path_factory.mktemp("monday")
    save(ARM, folder / "arm.yaml")
    rig = Float(postures(10, seed=3), noise=(0.0005, 0.001))
    record(folder / "bags", rig.samples(rate=20))
    told = ["--arm", str(folder / "arm.yaml"), "--result", str(folder / "result.json")]
    assert from_bag(["--dynamic", str(folder / "bags"), *told, *SEEN, *MAX]) == 0
    return folder


def promised(folder, *options):
    """By name, of two more maneuvers."""
    plan = folder / "plan.yaml"
    given = ["--arm", str(folder / "arm.yaml"), "--count", "2", "--kinds", "sweep", *MAX]
    assert design([*given, "--output", str(plan), *options]) == 0
    return yaml.safe_load(plan.read_text())["promised"]


@pytest.fixture(scope="module")
def planned(monday):
    """What was promised of two maneuvers after those of the bag, whose noise is given."""
    found = promised(monday, "--bag", str(monday / "bags"), *SEEN)
    (monday / "plan.yaml").rename(monday / "planned.yaml")
    return found


def test_what_was_made_before_counts_for_the_promise(monday, planned, capsys):
    found = read_passed(monday / "result.json", "dynamic")
    now = dict(zip(found["names"], found["deviations"], strict=True))
    for then in (planned, promised(monday, "--result", str(monday / "result.json"), *SEEN)):
        for i in range(1, 5):
            assert 0.4 * now[f"b_{i}"] < then[f"b_{i}"] < now[f"b_{i}"]
    alone = promised(monday, *SEEN)
    assert all(alone[name] > 2.0 * now[name] for name in ("b_1", "I_1") if name in alone)
    assert "assumed errors of a base pose: 0.5 mm and 0.057 degrees" in capsys.readouterr().out


def test_the_noise_is_that_of_the_bag(monday, capsys):
    promised(monday, "--bag", str(monday / "bags"))
    words = capsys.readouterr().out.partition("assumed errors of a base pose: ")[2].split()
    assert float(words[0]) == pytest.approx(0.5, abs=0.2)  # of ten maneuvers


def test_the_report_has_promised_beside_achieved(monday, planned, capsys):
    given = ["--dynamic", str(monday / "bags"), "--arm", str(monday / "arm.yaml"), *SEEN, *MAX]
    assert from_bag([*given, "--plan", str(monday / "planned.yaml")]) == 0
    rows = [row.split("│") for row in capsys.readouterr().out.splitlines() if "│ b_2 " in row]
    cells = [float(x) for x in rows[0] if x.strip().replace(".", "").isdigit()]
    assert np.isclose(cells, planned["b_2"], atol=1e-4).any()
    assert from_bag([*given, "--plan", str(monday / "arm.yaml")]) == 1
    assert "expected maneuvers, as `design` writes them" in capsys.readouterr().err
