"""Rehearsals by name, as a person runs them; and what a page says of one that went wrong."""

import subprocess
import sys

import numpy as np
import pytest

from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros import report
from fss_arm_ros.convert import SECOND, to_time
from fss_rehearsal import first_day, power_failure
from fss_rehearsal.__main__ import REHEARSALS
from fss_rehearsal.rehearsed import Check, Rehearsed
from fss_rehearsal.wifi_outage import Times, evaluate

TIMES = Times(*(s * SECOND for s in (5, 10, 16, 20, 24)))
FAILURE = power_failure.Times(*(s * SECOND for s in (10, 16, 20, 21, 24)))


def rehearse(*arguments):
    command = [sys.executable, "-m", "fss_rehearsal", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wifi_outage", "power_failure", "first_day", "drift"])
def test_it_goes_as_expected(tmp_path, name):
    """In half a minute to a minute each."""
    done = rehearse(name, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all expectations met" in (tmp_path / "out/report/index.html").read_text()
    assert (tmp_path / f"out/report/{name}.png").stat().st_size > 10_000
    assert (tmp_path / "out/bag").is_dir()


def test_what_there_is_is_said():
    helped = rehearse("--help")
    assert helped.returncode == 0
    assert all(name in helped.stdout for name in REHEARSALS)
    assert not [line for line in helped.stdout.splitlines() if len(line) > 80]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "NAME is missing, expected one of demo, dynamic"),
        (("lunch",), "no rehearsal 'lunch'; expected one of demo, dynamic"),
        (("dynamics",), "no rehearsal 'dynamics'; is it dynamic?"),
        (("demo", "--sped", "3"), "unrecognized arguments: --sped 3"),
        (("demo", "--postures", "3"), "argument --postures: invalid choice: 3"),
    ],
)
def test_a_wrong_command_line_is_an_error_and_no_failed_check(arguments, words):
    done = rehearse(*arguments)
    assert (done.returncode, done.stdout) == (1, "")
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_page_says_what_was_not_as_expected(tmp_path):
    checks = [Check("it flies", "it did", True), Check("it lands", "it <fell>", False)]
    found = Rehearsed(checks).report("Rehearsal: x", "of nothing")
    assert (found.verdict, found.reason) == ("fail", "it <fell>, expected: it lands")
    page = report.write(tmp_path, found).read_text()
    assert "it &lt;fell&gt;, expected: it lands" in page
    worse = Rehearsed([*checks, *checks]).report("Rehearsal: x", "of nothing")
    words = "2 of 4 expectations not met; the first: it <fell>, expected: it lands"
    assert worse.reason == words
    late = "the computer was overloaded"
    assert Rehearsed([*checks, *checks], invalid=late).report("", "").reason == f"{late}; {words}"
    assert Rehearsed(checks[:1], invalid=late).report("", "").reason == "all expectations met"


TIME = np.arange(0, 24 * SECOND, SECOND // 50)


def telemetry(link, at, **fields):
    """Return the report of a link at a time [s]."""
    message = LinkTelemetry(link=link, **fields)
    message.header.stamp = to_time(round(at * SECOND))
    return message


def outage(stops=12.0, creeps=0.0, armed=False, heard=17.0, again=0.05):
    """Checks of a made-up outage: joints' rates and telemetry."""
    rate = np.where(stops * SECOND > TIME, 0.05, creeps)
    rate[TIME > 21 * SECOND] = again
    times = (9.0, heard, heard + 1.0)
    told = [telemetry(i, at, armed=at < 10.0 or armed) for i in (1, 2, 3, 4) for at in times]
    return [check.passed for check in evaluate(TIMES, TIME, np.outer(rate, np.ones(4)), told)]


def failure(before=0.05, mute=True, heard=17.0, flags=0, mode=0, homed=True, again=0.05):
    """Checks of a made-up power failure: the joint's rate and its link's telemetry."""
    rate = np.where(TIME < 10 * SECOND, before, np.where(TIME > 21 * SECOND, again, 0.0))
    told = [
        telemetry(2, at, flags=int(State.REFERENCED if at > 21.0 and homed else flags), mode=mode)
        for at in (9.0, *(() if mute else (13.0,)), heard, heard + 1.0, 23.0)
    ]
    return [check.passed for check in power_failure.evaluate(FAILURE, TIME, rate, told)]


@pytest.mark.parametrize(
    ("how", "missed"),
    [
        ({}, set()),
        ({"before": 0.0}, {0}),
        ({"mute": False}, {1}),
        ({"heard": 21.5}, {2, 3, 4, 5}),
        ({"flags": State.ARMED}, {3}),
        ({"flags": State.REFERENCED}, {4}),
        ({"mode": 21}, {5}),
        ({"homed": False}, {6}),
        ({"again": 0.0}, {7}),
    ],
)
def test_a_power_failure_is_judged_by_what_the_bag_says(how, missed):
    assert {k for k, held in enumerate(failure(**how)) if not held} == missed


def test_a_first_day_is_as_expected_if_all_was_tried_and_passes():
    good = [{"name": f"{k}", "verdict": "pass", "found": "it is"} for k in range(9)]
    assert all(check.passed for check in first_day.evaluate(good, 0))
    bad = [*good[:8], {"name": "stop", "verdict": "fail", "found": "still moves"}]
    assert [c.expected for c in first_day.evaluate(bad, 0) if not c.passed] == ["stop: pass"]
    assert not first_day.evaluate(good[:5], 0)[-1].passed
    assert not first_day.evaluate(good, 3)[-1].passed


@pytest.mark.parametrize(
    ("how", "missed"),
    [
        ({}, set()),
        ({"stops": 15.0}, {1, 2}),
        ({"creeps": 0.01}, {1, 2}),
        ({"heard": 21.5}, {3}),
        ({"armed": True}, {4}),
        ({"again": 0.0}, {5}),
    ],
)
def test_an_outage_is_judged_by_what_the_bag_says(how, missed):
    assert {k for k, held in enumerate(outage(**how)) if not held} == missed
