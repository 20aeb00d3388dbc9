"""What people are told: a verdict in one line, tables that fit, and all in one page."""

import re
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from calib_float import Float, postures
from calib_rests import ARM, SETTINGS, outcome, with_outlier
from calib_rig import feed
from rich.console import Console

from fss_arm_calib.acceptance import FAIL, PASS, Check, summarize
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.problem import HEADING_DEVIATION, OFFSETS
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.outcome import Estimate
from fss_arm_calib.report_parts import check_table, next_steps, table_report, with_description
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_model.kinematics import joint_positions
from fss_arm_ros import report
from fss_rehearsal.dynamic import maneuvers_done
from fss_rehearsal.rehearsed import Check as Expectation
from fss_rehearsal.rehearsed import Rehearsed

STATE = np.array([0.1, 0.2, 3.0, 0.2, -0.1, 0.03, 0.0002, -0.0001])
TEXT = "a rather long explanation of what was expected, and what has happened in its place"


def lines(printable):
    console = Console(width=80)
    with console.capture() as capture:
        console.print(printable, highlight=False)
    return capture.get().splitlines()


def printed(told, details=False):
    return " ".join(" ".join(lines(report.printable(told, details))).split())


def test_the_tables_compare_with_the_paper_and_the_truth():
    text = printed(kinematic_report(outcome(), ARM), details=True)
    for words in ("a_1 .. a_3", "0.3825", "5.801", "18.211", "0.0150", "0.683", "truth", "pass: "):
        assert words in text
    assert "from a <bag>" in text


def test_checks_with_a_dimension_have_a_unit():
    table = check_table(outcome())
    units = {row[0]: row[-1] for row in table.rows}
    assert (table.head[-1], units["description"], units["fit"]) == ("unit", "m", "")


def test_the_page_holds_all_and_needs_no_other_file(tmp_path):
    told = kinematic_report(outcome())
    page = report.write(tmp_path / "report", told).read_text()
    opened = Counter(re.findall(r"<(\w+)", page)) - Counter(re.findall(r"</(\w+)", page))
    assert opened.keys() <= {"meta", "img"}
    sources = re.findall(r'(?:src|href)="([^"]*)', page)
    assert len(sources) == 3
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "http" not in re.sub(r"base64,[^\"]*", "", page)
    text = " ".join(unescape(re.sub("<[^>]*>", " ", page)).split())
    words = "18.211", "from a <bag>", "more than 5", "held out", "fit", "Checks", "Observations"
    for word in (*words, "position_deviation: 0.0177"):
        assert word in text, word
    for figure in told.figures:
        png = (tmp_path / "report" / f"{figure.name}.png").read_bytes()
        assert png.startswith(b"\x89PNG")


@pytest.mark.parametrize("count", [3, 13])
def test_under_the_verdict_stand_the_date_and_what_to_do_now(tmp_path, count):
    told = kinematic_report(outcome(count))
    symbols, when, then = told.below
    assert symbols == ("a: length; theta_0: encoder offset; BJ1: joint 1 in the base's frame")
    assert re.fullmatch(r"Data of .* to .*; reported \d{4}-\d\d-\d\d \d\d:\d\d UTC\.", when)
    page = report.write(tmp_path, told).read_text()
    assert page.index(told.reason[:20]) < page.index(when) < page.index(then) < page.index("<table")
    assert (told.verdict == "not_evaluated") == then.startswith("Next: record the missing data")


def test_the_drawings_show_the_estimated_arm():
    """Also where most of it was not estimated."""
    settings = replace(SETTINGS, parametrization=OFFSETS, theta_e=True)
    c = outcome(settings=settings)
    (drawing, *_), q = kinematic_report(c).figures, np.array([o.q for o in c.used])
    lines = drawing.draw().axes[0].lines
    values = dict(zip(c.names, c.values, strict=True))
    arm = ARM.with_kinematics(
        [
            *[link.a for link in ARM.links],
            *[values[f"theta_0_{i}"] for i in (2, 3, 4)],
            *ARM.base.mount[:2],
            values["theta_BJ1"],
        ]
    )
    expected = joint_positions(arm.vector(), np.column_stack([np.zeros((len(q), 3)), q]))
    for k, points in enumerate(expected):
        np.testing.assert_allclose(lines[2 * k].get_xydata(), points, atol=1e-12)


@pytest.mark.parametrize("text", ["<b>", 'a "quoted" & more'])
def test_texts_are_escaped(tmp_path, text):
    table = report.Table(text, [text], [[text]], note=text)
    told = report.Report(text, "fail", text, [table], text, texts={text: text})
    page = report.write(tmp_path, told).read_text()
    body = page[page.index("<section>") : page.index("</section>") + len("</section>")]
    assert [e.text for e in ET.fromstring(body).iter("td")] == [text]


@pytest.fixture(scope="module")
def maneuvers():
    return feed(
        ManeuverFinder(4), Float(postures(8, seed=5), None, STATE, 5.2, (5e-4, 2e-3)).samples()
    )


@pytest.mark.slow
def test_a_dynamic_calibration_is_told_as_well(maneuvers, tmp_path, monkeypatch):
    settings = DynamicSettings(position_deviation=5e-4, heading_deviation=2e-3)
    found = calibrate_dynamics(maneuvers, ARM, settings)
    told = dynamic_report(found, ARM, (1e-3, 0.0))
    table = told.tables[0]
    truths = {row[0]: row[table.head.index("truth")] for row in table.rows}
    assert [truths["g_x"], truths["g_y"]] == ["0.001000", "0.000000"]
    page = report.write(tmp_path, told, kinematic_report(outcome())).read_text()
    share = np.zeros(len(found.names))
    share[[1, 3]] = 0.51
    monkeypatch.setattr(type(found.solution.result), "prior_share", share)
    undetermined = set(np.flatnonzero(np.isinf(found.estimate.deviations)))
    assert set(dynamic_report(found).tables[0].weak) == {1, 3} | undetermined
    assert len(undetermined) < 4
    for words in ("prior [%]", "Bias due to assumed parameters", "hardly seen", "a &lt;bag&gt;"):
        assert words in page
    names = {figure.name for figure in told.figures}
    assert names == {f"dynamic_{n}" for n in ("motion", "residuals", "maneuvers", "correlation")}
    assert all((tmp_path / f"{name}.png").exists() for name in names)
    # the prediction passes through what is measured, in each maneuver
    drawing = {figure.name: figure for figure in told.figures}["dynamic_motion"].draw()
    heading = [line.get_xydata() for line in drawing.axes[2].lines]
    curves = [line for line in heading if len(line) > 50]
    dots = [line for line in heading if 2 < len(line) <= 50]
    assert len(curves) == len(dots) == len(maneuvers)
    for curve, seen in zip(curves, dots, strict=True):
        assert np.abs(np.interp(seen[:, 0], *curve.T) - seen[:, 1]).max() < 0.5
    assert np.abs(np.vstack(dots)[:, 1]).max() > 5.0


def test_without_a_solution_the_page_tells_why(maneuvers, tmp_path):
    few = calibrate_dynamics(maneuvers[:2], ARM, DynamicSettings())
    for told, words in (
        (kinematic_report(outcome(3)), "not evaluated: 3 observations, at least 6"),
        (dynamic_report(few), "not evaluated: 2 maneuvers"),
    ):
        assert told.figures == ()
        text = printed(told)
        assert words in text
        assert "truth" not in text
        page = report.write(tmp_path, told)
        assert told.reason[:20] in page.read_text()
        assert list(tmp_path.iterdir()) == [tmp_path / "index.html"]


def test_what_is_hardly_known_is_amber():
    found = outcome()
    assert kinematic_report(found).tables[0].weak == []
    deviations = found.estimate.deviations.copy()
    deviations[2] = 3.1 * HEADING_DEVIATION
    found = replace(found, estimate=replace(found.estimate, deviations=deviations))
    assert kinematic_report(found).tables[0].weak == [2]


def test_symbols_are_set_as_books_set_them_and_what_is_weak_or_wrong_is_marked(tmp_path):
    rows = [["theta_0_2", "rad"], ["I_6", "kg m^2"], ["x_BJ1", "m"], ["link_1", "arm_2.yaml"]]
    rows += [["a", "fail"], ["b", "not evaluated"], ["c", "pass"]]
    table = report.Table("Parameters", ["parameter", "unit"], rows, words=2, weak=[1])
    page = report.write(tmp_path, report.Report("of <it>", "fail", "", [table], "")).read_text()
    symbols = "<i>&theta;</i><sub>0,2</sub>", "<i>I</i><sub>6</sub>", "<i>x</i><sub>BJ1</sub>"
    for cell in (*symbols, "kg m<sup>2</sup>", "link_1", "arm_2.yaml"):
        assert f">{cell}</td>" in page
    for cell in ('"word bad">fail<', '"word weak">not evaluated<', '"word">pass<'):
        assert cell in page
    weak = '<tr class="weak">'
    assert page.count(weak) == page.count(f'{weak}<td class="word"><i>I') == 1


def words_of(table):
    return {word for row in (table.head, *table.rows) for cell in row for word in cell.split()}


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


@pytest.mark.parametrize("seed", range(5))
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
    assert report.console().width == 80 >= len(brief[0])  # without a terminal
    assert "condition number" not in " ".join(brief)
    for words in ("condition number", "predicted", "SHA-256", "Observations"):
        assert words in " ".join(full)
    assert len(brief) < 22 < len(full)


def test_terminal_description_and_page_say_one_chi_square(tmp_path):
    """Also where the deviations are estimated, so that the residuals have another one."""
    found = calibrate(with_outlier()[5:], ARM, replace(KinematicSettings(), min_observations=6))
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
        assert next_steps(found)[0].startswith("Next: keep the bag; write the desc")
        below = with_description(table_report(found), "arm.yaml").below
        assert below[-1].endswith("give the nodes -p arm:=arm.yaml.")
        return
    assert found.summary == f"13 observations; do not rely on {named}"
    seen = lines(report.printable(table_report(found)))
    assert seen[0] == f"pass: {found.summary}"
    all_of_them = " ".join(f"I_{k + 1}" for k, share in enumerate(shares) if share > 0.25)
    assert "    --arm my_arm.yaml \\" in seen
    assert f"    --chosen '{all_of_them}' --output plan.yaml" in seen


def test_maneuvers_are_counted_by_their_stops():
    plan = [SimpleNamespace(durations=[1.0] * number) for number in (3, 1, 2)]
    assert [maneuvers_done(plan, k) for k in range(9)] == [0, 0, 0, 0, 1, 2, 2, 3, 3]
