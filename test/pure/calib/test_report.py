"""What people are told: all in one page."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from calib_float import Float, feed, postures
from calib_reported import SETTINGS, outcome
from calib_rig import ARM
from rich.console import Console

from fss_arm_calib import report
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.kinematic.problem import HEADING_DEVIATION, OFFSETS
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_model.kinematics import joint_positions

STATE = np.array([0.1, 0.2, 3.0, 0.2, -0.1, 0.03, 0.0002, -0.0001])


def printed(told, details=False):
    console = report.console()
    with console.capture() as capture:
        console.print(report.printable(told, details))
    return " ".join(capture.get().split())


def test_the_tables_compare_with_the_paper_and_the_truth():
    text = printed(kinematic_report(outcome(), ARM), details=True)
    for words in ("a_1 .. a_3", "0.3825", "5.801", "18.211", "0.0150", "0.683", "truth", "pass: "):
        assert words in text
    assert "from a <bag>" in text
    text = printed(kinematic_report(outcome(3)))
    assert "not evaluated: 3 observations" in text
    assert "truth" not in text


class Page(HTMLParser):
    """Tags that are open, what was loaded from where, and all text."""

    def __init__(self):
        super().__init__()
        self.open, self.sources, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_holds_all_and_needs_no_other_file(tmp_path):
    told = kinematic_report(outcome())
    path = report.write(tmp_path / "report", told)
    page = Page()
    page.feed(path.read_text())
    assert page.open == []
    assert len(page.sources) == 3
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert "http" not in re.sub(r"base64,[^\"]*", "", path.read_text())
    text = " ".join(" ".join(page.text).split())
    for words in (
        "18.211",
        "from a <bag>",
        "more than 5",
        "held out",
        "fit",
        "position_deviation: 0.0177",
        "Checks",
        "Observations",
    ):
        assert words in text, words
    for figure in told.figures:
        png = (tmp_path / "report" / f"{figure.name}.png").read_bytes()
        assert png.startswith(b"\x89PNG")


@pytest.mark.parametrize("count", [3, 13])
def test_under_the_verdict_stand_the_date_and_what_to_do_now(tmp_path, count):
    told = kinematic_report(outcome(count))
    when, then = told.below
    assert re.fullmatch(r"Data of .* to .*, report of \d{4}-\d\d-\d\d \d\d:\d\d UTC\.", when)
    page = report.write(tmp_path, told).read_text()
    assert page.index(told.reason[:20]) < page.index(when) < page.index(then) < page.index("<table")
    assert (told.verdict == "not_evaluated") == then.startswith("Next: record the missing data")


def test_what_is_weak_or_wrong_is_marked(tmp_path):
    rows = [["a", "fail"], ["b", "not evaluated"], ["c", "pass"]]
    table = report.Table("checks", ["check", "verdict"], rows, words=2)
    page = report.write(tmp_path, report.Report("t", "fail", "r", [table], "o")).read_text()
    for cell in ('"word bad">fail<', '"word weak">not evaluated<', '"word">pass<'):
        assert cell in page


def test_no_column_of_a_printed_table_is_cut_off():
    name = "a_rather_long_name_of_a_parameter_that_does_not_fit"
    told = report.Table("t", ["parameter", "value"], [[name, "1"]])
    console = Console(width=30, record=True)
    console.print(told)
    assert name in re.sub(r"[\W\d]", "", console.export_text())


def test_without_a_solution_the_page_tells_why(tmp_path):
    told = kinematic_report(outcome(3))
    assert told.figures == ()
    text = report.write(tmp_path, told).read_text()
    assert "3 observations, at least 6 needed" in text
    assert list(tmp_path.iterdir()) == [tmp_path / "index.html"]


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
    told = dynamic_report(found, ARM)
    page = report.write(tmp_path, told, kinematic_report(outcome())).read_text()
    share = np.zeros(len(found.names))
    share[[1, 3]] = 0.51
    monkeypatch.setattr(type(found.solution.result), "prior_share", share)
    assert dynamic_report(found).tables[0].weak == [1, 3]
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


def test_a_dynamic_calibration_without_a_solution_is_told(maneuvers, tmp_path):
    told = dynamic_report(calibrate_dynamics(maneuvers[:2], ARM, DynamicSettings()))
    assert "not evaluated: 2 maneuvers" in printed(told)
    report.write(tmp_path, told)
    assert list(tmp_path.iterdir()) == [tmp_path / "index.html"]


def test_what_is_hardly_known_is_amber():
    found = outcome()
    assert kinematic_report(found).tables[0].weak == []
    deviations = found.estimate.deviations.copy()
    deviations[2] = 3.1 * HEADING_DEVIATION
    found = replace(found, estimate=replace(found.estimate, deviations=deviations))
    assert kinematic_report(found).tables[0].weak == [2]


def test_symbols_are_set_as_books_set_them(tmp_path):
    rows = [["theta_0_2", "rad"], ["I_6", "kg m^2"], ["x_BJ1", "m"], ["link_1", "arm_2.yaml"]]
    table = report.Table("Parameters", ["parameter", "unit"], rows, words=2, weak=[1])
    page = report.write(tmp_path, report.Report("of <it>", "pass", "", [table], "")).read_text()
    for cell in (
        "<i>&theta;</i><sub>0,2</sub>",
        "<i>I</i><sub>6</sub>",
        "kg m<sup>2</sup>",
        "<i>x</i><sub>BJ1</sub>",
        "link_1",
        "arm_2.yaml",
    ):
        assert f">{cell}</td>" in page
    assert (
        page.count('<tr class="weak">') == page.count('<tr class="weak"><td class="word"><i>I') == 1
    )
