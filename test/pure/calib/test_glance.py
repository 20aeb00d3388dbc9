"""Results at a glance: a verdict in one line, a table that fits, one chi-square."""

import re
from dataclasses import replace

import numpy as np
import pytest
from calib_reported import SETTINGS, observations, outcome
from calib_rig import ARM
from rich.console import Console

from fss_arm_calib import report
from fss_arm_calib.acceptance import FAIL, PASS, Check, summarize
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.outcome import Estimate
from fss_arm_calib.report_tables import next_steps, table_report
from fss_rehearsal.dynamic import maneuvers_done
from fss_rehearsal.rehearsed import Check as Expectation
from fss_rehearsal.rehearsed import Rehearsed

TEXT = "a rather long explanation of what was expected, and what has happened in its place"


def lines(printable, width=80):
    console = Console(width=width)
    with console.capture() as capture:
        console.print(printable, highlight=False)
    return capture.get().splitlines()


def words_of(table):
    return {word for row in (table.head, *table.rows) for cell in row for word in cell.split()}


def test_without_a_terminal_80_columns_are_assumed():
    assert report.console().width == 80


@pytest.mark.parametrize("details", [False, True])
def test_a_report_fits_80_columns_and_breaks_no_word(details):
    rehearsed = Rehearsed([Expectation(TEXT, TEXT, True), Expectation(TEXT, "no", False)])
    for told in (kinematic_report(outcome(), ARM), rehearsed.report("Rehearsal: demo", TEXT)):
        seen = lines(report.printable(told, details))
        assert max(map(len, seen)) <= 80
        assert seen[0].startswith(("pass: ", "fail: "))
        tables = [*told.tables, *told.details] if details else [told.tables[0].brief]
        missing = set().union(*map(words_of, tables)) - set(" ".join(seen).split())
        assert not missing


@pytest.mark.parametrize("seed", range(20))
def test_a_table_of_any_size_is_continued_below(seed):
    rng = np.random.default_rng(seed)
    columns, rows = rng.integers(1, 16), rng.integers(0, 4)
    words = int(rng.integers(1, 3))

    def cell(k):
        length = rng.integers(1, 12) if k < words else 1
        return " ".join("w" * rng.integers(1, 12) for _ in range(length))

    head = [f"head{k} [deg]" for k in range(columns)]
    body = [[cell(k) for k in range(columns)] for _ in range(rows)]
    table = report.Table("title", head, body, words)
    seen = lines(table)
    assert max(map(len, seen)) <= 80
    assert words_of(table) <= set(" ".join(seen).split())
    assert all("title" in line for line in (seen[0], *(x for x in seen if "continued" in x)))


def test_the_chain_of_checks_is_printed_with_the_details_only():
    told = kinematic_report(outcome())
    brief, full = (lines(report.printable(told, details)) for details in (False, True))
    assert brief[0] == f"pass: {told.reason}" == full[0]
    assert len(brief[0]) <= 80
    assert "condition number" not in " ".join(brief)
    for words in ("condition number", "predicted", "SHA-256", "Observations"):
        assert words in " ".join(full)
    assert len(brief) < 22 < len(full)


def test_terminal_description_and_page_say_one_chi_square(tmp_path):
    """Also where the deviations are estimated, so that the residuals have another one."""
    found = calibrate(observations()[5:], ARM, replace(KinematicSettings(), min_observations=6))
    assert found.verdict == PASS
    told = kinematic_report(found)
    (said,) = re.findall(r"chi-square of the fit (\S+) for (\d+) degrees", told.reason)
    (check,) = (c for c in found.checks if c.name == "fit")
    assert f"chi-square {said[0]} for {said[1]} degrees of freedom, " in check.reason
    assert said[0] != f"{found.estimate.chi_square:.4g}"
    header = found.description.partition("\nname")[0]
    assert f"# pass: {found.summary}\n" in header
    assert header.count("chi-square") == 1
    page = report.write(tmp_path, told).read_text()
    assert f"</span> {found.summary}</p>" in page


def test_one_reason_is_given_and_it_is_the_first():
    checks = [
        Check("number", PASS, 8, 6, "8 rests (at least 6)", brief="8 rests"),
        Check("fit", FAIL, 0, 1, "too large"),
        Check("outliers", FAIL, 9, 5, "rest 3 inconsistent"),
    ]
    assert summarize(checks) == "too large"
    assert summarize(checks[:1]) == "8 rests"
    assert summarize([replace(checks[0], brief="")]) == "8 rests (at least 6)"
    long = replace(checks[1], reason="too large, because " + 9 * "of this ", brief="in short")
    assert summarize([checks[0], long, checks[2]]) == "in short"
    assert summarize([replace(long, reason="too large")]) == "too large"
    assert summarize([]) == ""
    assert summarize(checks, {"I_1": 0.7}) == "too large"


def uncertain(shares, **changes):
    """An outcome that passes, with inertias known to relative deviations."""
    n = len(shares)
    names = tuple(f"I_{i}" for i in range(1, n + 1))
    estimate = Estimate(
        (*names, "m_0", "b_1"),
        (*("kg m^2",) * n, "kg", "m"),
        np.ones(n + 2),
        np.array([*[-0.02] * n, 10.0, 0.1]),
        deviations=np.array([*0.02 * np.array(shares), 2.5, 1.0]),
        **changes,
    )
    return replace(outcome(), estimate=estimate, settings=replace(SETTINGS, arm="my_arm.yaml"))


CASES = {
    "known": ([0.25, 0.1], ""),
    "one": ([0.1, 0.72], "I_2 (± 72 %)"),
    "two": ([0.3, 0.72], "I_2 (± 72 %), I_1 (± 30 %)"),
    "more": ([0.3, 0.72, 0.26, 0.5], "I_2 (± 72 %), I_4 (± 50 %) and 2 more"),
    "undetermined": ([0.1, np.inf], "I_2 (not determined)"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_pass_names_what_is_too_uncertain_to_use_and_how_to_plan_more(case):
    shares, named = CASES[case]
    found = uncertain(shares)
    assert found.verdict == PASS
    if not named:
        assert "chi-square" in found.summary
        assert next_steps(found)[0].startswith("Next: give the calibrated description")
        return
    assert found.summary == f"13 observations; record more to use {named}"
    seen = lines(report.printable(table_report(found)))
    assert seen[0] == f"pass: {found.summary}"
    all_of_them = " ".join(f"I_{k + 1}" for k, share in enumerate(shares) if share > 0.25)
    assert "  ros2 run fss_arm_calib design --bag BAG --arm my_arm.yaml \\" in seen
    assert f"    --chosen '{all_of_them}' --output plan.yaml" in seen


def test_not_evaluated_is_one_line():
    seen = lines(report.printable(kinematic_report(outcome(3))))
    assert seen[0].startswith("not evaluated: 3 observations, at")


class Moves:
    def __init__(self, number):
        self.durations = [1.0] * number


def test_maneuvers_are_counted_by_their_stops():
    plan = [Moves(3), Moves(1), Moves(2)]
    assert [maneuvers_done(plan, k) for k in range(9)] == [0, 0, 0, 0, 1, 2, 2, 3, 3]
