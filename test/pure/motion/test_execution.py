"""What `fss_arm.sh execute` waits for, warns about and prints."""

from dataclasses import replace
from math import nan, radians
from types import SimpleNamespace

import pytest

from fss_arm_model.description import paper_arm
from fss_arm_motion.execution import ArmState, format_report, other_description
from fss_arm_motion.plan_file import digest

REPORT = SimpleNamespace(
    arm="paper", predicted=[0.0123, -0.0456, radians(30.0)],
    predicted_deviation=[0.0004, 0.0005, radians(0.25)],
    measured=[0.0125, -0.0466, radians(30.5)], predicted_excursion=radians(117.9),
    measured_excursion=radians(118.0),
)  # fmt: skip


def test_the_report_has_labels_units_and_deviations():
    assert format_report(REPORT).splitlines() == [
        "change of the base    predicted  1 sigma  measured           difference",
        "  x [mm]                   12.3      0.4      12.5      0.2 (0.5 sigma)",
        "  y [mm]                  -45.6      0.5     -46.6     -1.0 (2.0 sigma)",
        "  heading [deg]           30.00     0.25     30.50     0.50 (2.0 sigma)",
        "  largest turn [deg]     117.90             118.00",
    ]


def test_what_is_not_known_is_said():
    unknown = {**vars(REPORT), "predicted_deviation": [nan] * 3, "measured": [nan] * 3}
    lines = format_report(SimpleNamespace(**unknown)).splitlines()
    assert lines[1].split() == ["x", "[mm]", "12.3", "-", "-", "-"]
    assert lines[-2:] == [
        "not measured: no base/state was received",
        "1 sigma is unknown: 'paper' has no calibration",
    ]


def test_an_arm_is_ready_once_all_links_are_armed_and_at_rest():
    state = ArmState(2)
    assert state.missing(0.0).startswith("arm/joint_states: ")
    state.received, state.rate = 10.0, 0.2
    assert state.missing(10.0) == "telemetry of links 1, 2"
    state.armed = {1: (10.0, True), 2: (10.0, False)}
    assert state.missing(10.0) == "link 2 to be armed: scripts/fss_arm.sh arm"
    state.armed[2] = 10.0, True
    assert state.missing(10.0) == "the arm to rest"
    state.rate = 0.0
    assert state.missing(10.0) == ""
    assert state.missing(13.5).startswith("arm/joint_states: ")


CAD = replace(paper_arm(), name="cad")


@pytest.mark.parametrize(
    ("running", "initial", "words"),
    [
        ("paper", paper_arm(), ""),
        ("", None, ""),
        ("cad", None, ""),
        ("cad", paper_arm(), ""),
        ("cad", CAD, "the node motion has 'cad', this plan is for 'paper'"),
        ("", replace(paper_arm(), theta_E=0.1), "'paper' has changed since"),
        ("paper", CAD, ""),  # after a calibration
    ],
)
def test_another_description_is_warned_of(running, initial, words):
    stored = SimpleNamespace(arm="paper", digest=digest(paper_arm()))
    assert words in other_description(stored, running, initial)
    assert bool(words) == bool(other_description(stored, running, initial))
