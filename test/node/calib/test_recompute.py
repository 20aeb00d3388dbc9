"""Recorded results computed again from what was recorded with them."""

from copy import deepcopy
from dataclasses import replace
from functools import cache
from math import nan
from pathlib import Path

import pytest
from calib_kinds import recorded
from calib_rests import ARM, observe, shifted

from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.recompute import main

FIRST = Path(__file__).parents[2] / "data/first"
SETTINGS = KinematicSettings(max_outliers=2, loss="huber")


@cache
def results():
    """Return observations and result after each rest."""
    rests = observe(sigma=0.0)
    rests[4] = shifted(rests[4], 0.5, 0.5, 0.5)
    rests.insert(7, replace(rests[7], used=False, reason="a gap", tip=3 * (nan,)))
    found = []
    for count in range(1, len(rests) + 1):
        result = calibrate(rests[:count], ARM, SETTINGS)
        observations = KINEMATIC.data.to_message(rests[:count], "fss")
        found.append((observations, KINEMATIC.to_message(result, "fss")))
    return found


@pytest.fixture
def published():
    return deepcopy(results())


def test_every_result_follows_from_its_observations(published, tmp_path, capsys):
    assert main([recorded(tmp_path, KINEMATIC, *published)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 14
    assert lines[0] == "1 observation, not_evaluated: the same, to 0.0e+00"
    assert all("the same, to " in line for line in lines)
    assert lines[-1].startswith("13 observations, ")


def test_a_result_may_end_before_the_last_observation_used(published, tmp_path, capsys):
    """What follows was observed with other zeros of the joints than the last rest."""
    rests = [replace(o, boots=4 * (3,)) for o in KINEMATIC.data.from_message(published[-1][0])]
    told = [replace(o, homings=4 * (2 if k in (4, 5, 13) else 1,)) for k, o in enumerate(rests)]
    told[13] = replace(told[13], used=False)
    result = calibrate(told, ARM, SETTINGS)
    pair = KINEMATIC.data.to_message(told, "fss"), KINEMATIC.to_message(result, "fss")
    assert main([recorded(tmp_path, KINEMATIC, pair)]) == 0
    assert capsys.readouterr().out.startswith("2 observations, not_evaluated: the same")


def test_a_result_that_does_not_is_told(published, tmp_path, capsys):
    published[-1][1].calibration.values[2] += 1e-8
    assert main([recorded(tmp_path, KINEMATIC, *published)]) == 2
    assert capsys.readouterr().out.splitlines()[-1].endswith("NOT the same, to 1.0e-08")


def test_of_an_earlier_version_it_is_said_in_a_line_what_is_in_the_way(capsys):
    """Its observations lack fields, which have defaults; its result does not hold its settings."""
    assert main([str(FIRST)]) == 1
    assert capsys.readouterr().err == (
        "recompute: a result on /calibration/kinematic: parameters is '', expected those of "
        "KinematicSettings as YAML; earlier versions did not record them: use from_bag\n"
    )


def test_what_is_missing_is_named(published, tmp_path, capsys):
    assert main([recorded(tmp_path / "a", KINEMATIC, (published[0][0], None))]) == 1
    error = capsys.readouterr().err
    assert "no result on /calibration/kinematic or /calibration/dynamic or " in error
    others = [(published[0][0], result) for _, result in published]
    assert main([recorded(tmp_path / "b", KINEMATIC, *others)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(
        "recompute: the bag lacks the observations of a result on /calibration/kinematic ("
    )
    assert error.count("\n") == 1
    assert main(["/nowhere"]) == 1
    assert "no such file" in capsys.readouterr().err
