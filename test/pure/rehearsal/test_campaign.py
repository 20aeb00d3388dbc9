"""Campaigns: the file, its runs, their rows, and the statistics."""

from dataclasses import dataclass
from functools import partial
from math import nan
from pathlib import Path
from typing import Annotated

import pytest
from distributed import KilledWorker
from scipy.stats import binomtest

from fss_arm_model.settings import POSITIVE, SettingError, Settings, setting
from fss_rehearsal.campaign.arguments import Arguments
from fss_rehearsal.campaign.execute import finished_row
from fss_rehearsal.campaign.function import perform
from fss_rehearsal.campaign.options import parser
from fss_rehearsal.campaign.plan import CampaignError, read_campaign
from fss_rehearsal.campaign.results import (
    Results,
    check_rows,
    differences,
    picture_file,
    read_rows,
)
from fss_rehearsal.campaign.summary import summarize, wilson_interval
from fss_rehearsal.loops.capture import capture
from fss_rehearsal.loops.faults import FaultSettings
from fss_rehearsal.loops.parameters import ArmValues, Without

STUDY = """
from math import nan
def swing(seed, gain=1.0, mass: float = 10.0, start: tuple[float, ...] = (0.0, 0.0)):
    if gain > 3.0:
        raise RuntimeError("gain too high")
    return {"success": gain < 2.0, "error": gain * seed / mass, "slip": nan, "reason": ""}
"""
FILE = """
run: swing_study:swing
seeds: 4
settings: {mass: 12}
grid:
  gain: [0.5, 4.0]
  "start[1]": [0.0, 0.1, 0.2]
draw:
  "start[0]": {uniform: [-1.0, 1.0]}
measure: [error]
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "swing_study.py").write_text(STUDY)
    path = tmp_path / "study.yaml"
    path.write_text(FILE)
    return path


def rows_of(campaign):
    place, folder = campaign.function, campaign.file.parent
    return [perform(place, folder, run.number, run.seed, run.values) for run in campaign.runs]


def test_runs_are_the_grid_for_each_seed(file):
    runs = read_campaign(file).runs
    assert len(runs) == 4 * 2 * 3
    assert runs[4].cell == {"gain": "4", "start[1]": "0.1"}
    assert runs[4].values == {
        "mass": 12,
        "gain": 4.0,
        "start[1]": 0.1,
        "start[0]": runs[0].values["start[0]"],
    }
    assert len({run.values["start[0]"] for run in runs}) == 4  # one for each seed
    file.write_text(FILE.replace("seeds: 4", "seeds: 9"))
    assert read_campaign(file).runs[:24] == runs


def test_cycle_is_a_latin_square_of_last_axis_and_seed(file):
    file.write_text(FILE.replace("uniform: [-1.0, 1.0]", "cycle: [5.0, 6.0, 7.0]"))
    runs = read_campaign(file).runs
    for run in runs:
        k = ("0", "0.1", "0.2").index(run.cell["start[1]"])
        assert run.values["start[0]"] == 5.0 + (k + run.seed) % 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seeds: 4", "seed: 4", "seed is 4, expected seeds: ..."),
        ("seeds: 4", "seeds: 0", "seeds is 0, expected their number, or a list"),
        ("swing_study:swing", "captre", "run is 'captre', expected one of capture, hold"),
        (
            "swing_study:swing",
            "swing_study:sing",
            "run is 'swing_study:sing', expected a function module:function",
        ),
        ("seeds: 4", "loop: graf", "loop is 'graf', expected graph (all nodes), or no such key"),
        (
            "seeds: 4",
            "loop: graph",
            "loop is 'graph', expected run: capture or run: hold with it, not run: swing_study:swi",
        ),
        (
            "mass: 12",
            "mas: 12",
            "settings: mas is 12, expected a parameter of the run; the nearest name is mass",
        ),
        ("mass: 12", "mass: heavy", "settings: mass is 'heavy', expected a number"),
        (
            "mass: 12",
            "testbed.x: 2",
            "settings: testbed.x is 2, expected a parameter of the run: gain, mass, start",
        ),
        ("mass: 12", "seed: 2", "settings: seed is 2, expected the seeds under `seeds`"),
        ("start[1]", "start[2]", "grid: start[2] is 0.0, expected an index below 2"),
        ("gain: [0.5, 4.0]", "gain: 0.5", "grid: gain is 0.5, expected a list of values"),
        ("uniform", "unifrom", "draw: start[0] is 'unifrom', expected uniform as its kind"),
        ("[-1.0, 1.0]", "[1.0, -1.0]", "draw: start[0]: uniform is [1.0, -1.0], expected [low, hi"),
        ("measure: [error]", "measure: error", "measure is 'error', expected a list"),
        ("measure: [error]", "success_rate: 2", "success_rate is 2, expected a number from 0 to 1"),
    ],
)
def test_errors_name_key_value_and_what_was_expected(file, old, new, message):
    file.write_text(FILE.replace(old, new))
    with pytest.raises(CampaignError) as error:
        read_campaign(file)
    assert str(error.value).startswith(f"{file}: {message}")


@dataclass(frozen=True)
class Node(Settings):
    stand_off: float = setting(0.1, "distance", unit="m", check=POSITIVE)
    rate: float = setting(5.0, "rate of a topic", unit="Hz", check=POSITIVE)
    pose: tuple[float, ...] = setting((0.0, 1.0), "pose", unit="m")


def loop(guidance: Annotated[Node, Without("rate")] = Node(), arm: ArmValues = ArmValues()):  # noqa: B008
    return {"result": guidance.stand_off + sum(arm.values())}


def test_parameters_of_nodes_have_the_names_of_ros():
    built = Arguments(loop).build(
        {"guidance.pose[1]": 3, "guidance.stand_off": 1, "guidance.pose": [2, 2], "arm.m_1": 2.0}
    )
    assert built == {"guidance": Node(1.0, pose=(2.0, 3.0)), "arm": {"m_1": 2.0}}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("guidance.stand_of", 1, "the nearest name is guidance.stand_off"),
        ("guidance.rate", 1.0, "it has no effect on this run"),
        ("guidance.stand_off", -1, "guidance.stand_off is -1.0 m, expected a positive number"),
        ("arm.m_99", 1.0, "the nearest name is arm.m_9"),
    ],
)
def test_parameters_of_nodes_are_checked(key, value, message):
    with pytest.raises(ValueError, match=message):
        Arguments(loop).build({key: value})


def test_a_crash_is_a_row_with_its_reason(file):
    row = rows_of(read_campaign(file))[3]
    assert row["outcome"] == "crashed"
    assert row["reason"] == "RuntimeError: gain too high (swing_study.py:5)"


def test_a_fault_without_phase_is_refused():
    with pytest.raises(SettingError, match=r"fault\.phase is '', .* for the fault 'gyro'"):
        capture(1, fault=FaultSettings("gyro"))


def test_results_are_read_as_written_and_can_continue(file):
    campaign = read_campaign(file)
    rows = rows_of(campaign)
    results = Results(file.parent / "runs.parquet")
    for row in reversed(rows):
        results.add(row)
    results.write()
    read = read_rows(results.path)
    assert [row["run"] for row in read] == list(range(24))
    assert not any(differences(a, b) for a, b in zip(rows, read, strict=True))
    check_rows(read, campaign, rows[0]["commit"], results.path)
    with pytest.raises(CampaignError, match=r"run 0 was made with commit .*, expected other"):
        check_rows(read, campaign, "other", results.path)
    file.write_text(FILE.replace("mass: 12", "mass: 13"))
    with pytest.raises(CampaignError, match=r"run 0 has mass 12, expected 13 as in"):
        check_rows(read, read_campaign(file), rows[0]["commit"], results.path)


def test_a_campaign_does_not_continue_with_the_rows_of_another_function(file):
    campaign = read_campaign(file)
    row = rows_of(campaign)[0]
    with pytest.raises(CampaignError, match=r"run 0 is one of other:swing, expected swing_study:s"):
        check_rows([row | {"function": "other:swing"}], campaign, row["commit"], file)


def test_a_run_whose_worker_died_is_a_row_with_which_the_campaign_continues(file):
    class Lost:
        def result(self):
            raise KilledWorker("run-0", None, 2)

    campaign = read_campaign(file)
    row = finished_row(Lost(), campaign, campaign.runs[0])
    assert row["outcome"] == "crashed"
    check_rows([row], campaign, row["commit"], file)


def test_differences_of_rows_ignore_when_and_where_they_ran():
    row = {"run": 1, "error": nan, "wall_time": 1.0, "worker": "a"}
    assert not differences(row, row | {"error": float("nan"), "wall_time": 2.0, "worker": "b"})
    assert differences(row, row | {"error": 2.0}) == ["error: nan, before 2.0"]


@pytest.mark.parametrize(("successes", "runs"), [(0, 1), (0, 10), (7, 9), (279, 280), (5, 5)])
def test_wilson_interval_is_that_of_scipy(successes, runs):
    expected = binomtest(successes, runs).proportion_ci(0.95, "wilson")
    assert wilson_interval(successes, runs) == pytest.approx(tuple(expected), abs=1e-6)


def no_picture(_):
    return Path("no such file")


def test_report_shows_the_pictures_of_failed_runs(file):
    drawn = "return {'success': gain < 2.0, 'picture': figure, 'reason': 'too fast'}"
    (file.parent / "drawn_study.py").write_text(
        f"def figure():\n    from matplotlib.figure import Figure\n    return Figure()\n"
        f"def swing(seed, gain):\n    {drawn}\n"
    )
    file.write_text("run: drawn_study:swing\ngrid: {gain: [1.0, 3.0]}\n")
    campaign, results = read_campaign(file), Results(file.parent / "runs.parquet")
    for row in rows_of(campaign):
        results.add(row)
    assert not picture_file(results.path, 0).exists()
    report = summarize(
        campaign, list(results.rows.values()), "", partial(picture_file, results.path)
    )
    (figure,) = report.figures
    assert figure.title == "run 1: too fast"
    assert figure.png().startswith(b"\x89PNG")
    assert list(read_rows(results.path)[0]) == list(results.rows[0])


def test_report_has_rates_and_the_worst_runs(file):
    campaign = read_campaign(file)
    report = summarize(campaign, rows_of(campaign), "campaign study.yaml", no_picture)
    assert report.verdict == "fail"
    assert report.reason.startswith(
        "12 of 24 runs succeeded, 50.0 % (95 % interval 31.4 to 68.6 %)"
    )
    assert report.tables[0].rows[1] == ("4", "12", "0", "0.0 %", "0.0 to 24.2 %")
    worst = report.tables[-1]
    assert worst.rows[0][1] == "crashed"
    assert report.below == [f"repeat a run: campaign study.yaml --replay {worst.rows[0][0]}"]


@pytest.mark.parametrize("option", ["--runs", "--workers"])
@pytest.mark.parametrize("value", ["0", "-1", "two"])
def test_a_campaign_needs_runs_and_workers(capsys, option, value):
    """With no worker it would wait indefinitely."""
    with pytest.raises(SystemExit) as ended:
        parser().parse_args(["study.yaml", f"{option}={value}"])
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert said == f"campaign: argument {option}: '{value}' is given, expected 1 or more\n"
