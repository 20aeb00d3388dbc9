"""The verdict on each valve, as YAML, as a table and as an exit code."""

import numpy as np
import pytest
from rich.console import Console

from fss_arm_model.files import read_yaml
from fss_arm_model.thrusters import thruster_wrenches
from fss_base_driver.findings import (
    FAIL,
    NOT_TRIED,
    PASS,
    Finding,
    Trial,
    as_yaml,
    exit_code,
    judge_valve,
    table,
)
from fss_base_driver.thrust import Body, Thrust

VALVES = thruster_wrenches(0.16, 0.11)
BODY = Body(10.0, 0.25, (0.0, 0.0))
BEGIN = 3.0


def trial(valve, pushed_by, poses=500):
    """A pulse of a second, in whose middle the heading jumps by a turn."""
    x, y, torque = VALVES[pushed_by]
    record = Trial(valve, 1.0, BEGIN, open_valves=[0, 1 << valve, 0])
    for t in np.linspace(0.0, 8.0, poses):
        inside = np.clip(t - BEGIN, 0.0, 1.0)
        gained = 0.5 * inside * inside + max(t - BEGIN - 1.0, 0.0)
        turned = gained * torque / BODY.inertia
        heading = (turned + 2.0 * np.pi * (t > BEGIN + 0.5),)
        along = np.array([x, y]) / BODY.mass * gained
        record.poses.insert(0, (float(t), *along.tolist(), *heading))
        record.rates.append((float(t), inside * torque / BODY.inertia))
    return record


def test_a_valve_that_pushes_as_it_should_passes():
    found = judge_valve(trial(2, 2), BODY, VALVES, 0.2)
    assert (found.valve, found.verdict, found.words) == (3, PASS, "")
    assert found.thrust.torque == pytest.approx(VALVES[2, 2], abs=0.002)


def test_a_valve_that_does_not_open_or_is_swapped_fails():
    closed = trial(2, 2)
    closed.open_valves = [0, 1 << 3]
    assert judge_valve(closed, BODY, VALVES, 0.2) == Finding(3, FAIL, "the board did not open it")
    swapped = judge_valve(trial(2, 0), BODY, VALVES, 0.2)
    assert swapped.verdict == FAIL
    assert swapped.words.startswith("pushes as valve 1 should")


def test_a_track_that_is_too_short_proves_nothing():
    found = judge_valve(trial(2, 2, poses=20), BODY, VALVES, 0.2)
    assert found.verdict == NOT_TRIED
    assert found.words.endswith("expected 20 each")


@pytest.mark.parametrize(
    ("verdicts", "code"), [([PASS, PASS], 0), ([PASS, NOT_TRIED], 3), ([NOT_TRIED, FAIL, PASS], 2)]
)
def test_the_gravest_verdict_is_the_exit_code(verdicts, code):
    assert exit_code([Finding(k, verdict, "") for k, verdict in enumerate(verdicts, 1)]) == code


def test_the_findings_are_valid_yaml_and_a_table():
    thrust = Thrust((-0.16, 0.01), 0.0176, (0.002, 0.0003))
    findings = [Finding(2, FAIL, 'no thrust: "0"'), Finding(1, PASS, "", thrust)]
    first, second = read_yaml(as_yaml(findings, "now"))["valves"]
    measured = {"force": [-0.16, 0.01], "torque": 0.0176, "deviation": [0.002, 0.0003]}
    assert first == {"valve": 1, "verdict": PASS, **measured}
    assert second == {"valve": 2, "verdict": FAIL, "words": 'no thrust: "0"'}
    every = [Finding(k, PASS, "", thrust) for k in range(8, 0, -1)]
    assert read_yaml(as_yaml(every, "now"))["layout"] == 8 * [-0.16, 0.01, 0.0176]
    console = Console(width=120, record=True)
    console.print(table(findings))
    lines = console.export_text().splitlines()
    assert lines[1].split() == ["1", "-0.160,", "+0.010", "+0.0176", "0.002,", "0.0003", "pass"]
    assert 'fail: no thrust: "0"' in lines[2]
