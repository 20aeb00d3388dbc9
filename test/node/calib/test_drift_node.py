"""What is the drift calibration's own, on the streams of a drifting base."""

import numpy as np
import pytest
import yaml
from calib_float import ARM, Float, postures
from calib_rig import feed, record

from fss_arm_calib.calibration_node import CalibrationNode
from fss_arm_calib.drift.calibrate import calibrate
from fss_arm_calib.drift.kind import DRIFT
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.segments.drifts import DriftFinder
from fss_arm_model.units import GRAVITY, SECOND
from fss_arm_view.base_reaction_node import BaseReactionNode

TILT = np.array([2e-5, -1e-5])  # [rad]
STATE = np.array([0.1, -0.2, 0.4, 0.02, -0.01, 0.01, *GRAVITY * TILT])
NOISE = (0.001, 0.009)


@pytest.fixture(scope="module")
def samples():
    """Three rests of 40 s with a maneuver between two."""
    flight = Float(postures(2), state=STATE, rest=40.0, noise=NOISE)
    return [s for s in flight.samples(rate=20) if s.stream != "gyro"]


@pytest.fixture(scope="module")
def bag(samples, tmp_path_factory):
    return record(tmp_path_factory.mktemp("float") / "bag", samples)


def test_each_rest_is_a_drift_and_long_ones_are_several(samples):
    found = feed(DriftFinder(ARM.n), samples)
    assert [d.times[-1] > 35.0 for d in found] == [True] * 3
    shorter = feed(DriftFinder(ARM.n, DriftSettings(max_duration=22.0, min_duration=10.0)), samples)
    assert len(shorter) == 6
    ends = [d.end for d in shorter]
    assert all(b.start >= a for a, b in zip(ends, shorter[1:], strict=False))
    assert not feed(DriftFinder(ARM.n, DriftSettings(min_duration=50.0)), samples)


def test_the_truth_comes_back(bag):
    found = solve_bag(DRIFT, bag, DriftSettings(com_deviation=0.005))
    assert found.verdict == "pass"
    away = found.values[:2] - GRAVITY * TILT
    assert (np.abs(away) < 4.0 * found.deviations[:2]).all()
    torque, deviation = found.solution.result.hose_torque
    assert abs(torque) < 4.0 * deviation  # there is none
    momenta, deviations = found.solution.result.momenta
    expected = STATE[3:6]  # at the first drift's begin, but for what the tilt added within 0.5 s
    assert (np.abs(momenta[0] - expected) < 4.0 * deviations[0] + 1e-3).all()
    table = DRIFT.report_of(found).tables[0]
    for k, (*_, value, sigma) in enumerate(table.rows):
        assert (k in table.weak) == (abs(float(value)) <= 2.0 * float(sigma))


@pytest.mark.parametrize("namespace", ["", "/lab/fss2"])
def test_its_file_sets_the_other_nodes(bag, tmp_path, spin, capsys, namespace):
    output = tmp_path / "drift.yaml"
    assert from_bag(["--drift", str(bag), "--output", str(output)]) == 0
    assert "tilt along x" in capsys.readouterr().out
    told = yaml.safe_load(output.read_text())
    arguments = ["--ros-args", "--params-file", str(output)]
    arguments += ["-r", f"__ns:={namespace}"] if namespace else []
    dynamic, reaction = (
        CalibrationNode(DYNAMIC, cli_args=arguments),
        BaseReactionNode(cli_args=arguments),
    )
    spin([dynamic, reaction], lambda: True)
    for name, value in told["/**/dynamic"]["ros__parameters"].items():
        assert getattr(dynamic.settings, name) == value
    assert dynamic.settings.tilt_deviation >= 2e-5
    np.testing.assert_allclose(reaction.settings.tilt, TILT, atol=2e-6)


def test_a_drift_without_readings_of_a_joint_is_none(samples):
    """Silent through the second of the pieces that the first rest makes."""
    finder = DriftFinder(ARM.n, DriftSettings(max_duration=12.0, min_duration=5.0))
    pieces = feed(DriftFinder(ARM.n, finder.sensors.settings), samples)
    silent = pieces[0].end + SECOND // 4, pieces[1].end
    found = feed(finder, [s for s in samples if s.stream != 2 or not silent[0] < s.t < silent[1]])
    assert [d.end for d in found[:2]] == [pieces[0].end, pieces[2].end]
    assert calibrate(found, ARM).verdict == "pass"
    few = calibrate(found, ARM, DriftSettings(min_time=500.0))
    assert few.verdict == "not_evaluated"
    assert "at least 500 s needed" in few.reason
