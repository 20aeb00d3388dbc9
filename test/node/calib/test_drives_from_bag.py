"""Drives from a bag, to the calibrated description, and the plan that this asks for."""

import json
from pathlib import Path

import calib_rig
import numpy as np
import pytest
from calib_drives import excitation, fly, record, samples

from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.experiment.planned import read_plan
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.result import read_arm
from fss_arm_model.description_file import described, load, to_yaml


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Five frames a second of each link of the true arm."""
    arm = described("truth")
    flown = fly(arm, excitation(arm.n, np.random.default_rng(0)), seed=0)
    return str(record(tmp_path_factory.mktemp("drives"), samples(flown.telemetry)))


def test_a_bag_tells_the_drives(
    bag: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, result, truth = (tmp_path / name for name in ("arm.yaml", "drives.json", "truth.yaml"))
    truth.write_text(to_yaml(described("truth")))
    asked = ["--arm", "truth", "--truth", str(truth), "--max-relative", "0.2"]
    code = from_bag(["--drives", bag, *asked, "--output", str(output), "--result", str(result)])
    shown = capsys.readouterr().out
    assert code == 0, shown
    assert "torque_constant_1" in shown
    assert "dead_band" in shown
    drives = [link.drive.torque_constant for link in load(output).links]
    true = [link.drive.torque_constant for link in described("truth").links]
    found = json.loads(result.read_text())
    sigma = [found["deviations"][found["names"].index(f"torque_constant_{i}")] for i in range(1, 5)]
    assert np.all(np.abs(np.subtract(drives, true)) < 4.0 * np.array(sigma))
    assert "dead_band_1" in found["undetermined"]
    reasons = {check["name"]: check["reason"] for check in found["checks"]}
    words = "dead_band_1 not determined: the encoder is on the motor"
    assert reasons["dead_band_1"].startswith(words)


def test_a_bag_without_telemetry_is_refused(bag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert from_bag(["--drives", bag, "--namespace", "other"]) == 1
    assert "no /other/link_1/telemetry in" in capsys.readouterr().err


def test_another_bag_may_tell_the_kinematics(
    bag: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Which settings of such a calibration it has in common with this one depends on the kind."""
    rig = calib_rig.Rig(DEFAULT_POSTURES[:8], rest=3.2, rate=50.0)
    rests = str(calib_rig.record(tmp_path / "rests", rig.samples()))
    result = tmp_path / "drives.json"
    asked = ["--max-relative", "0.2", "--kinematic", rests, "--result", str(result)]
    assert from_bag(["--drives", bag, *asked]) == 0
    assert "a_1" in read_arm(result, "drives").known.names
    assert from_bag(["--drives", bag, "--kinematic", bag]) == 1
    assert "no /joint_states in" in capsys.readouterr().err


def test_design_proposes_moves_of_single_joints(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    assert design(["--kinds", "joint", "--repeats", "1", "--output", str(path)]) == 0
    plan = read_plan(path, 4)
    assert len(plan) == 8
    for one in plan:
        assert np.count_nonzero(np.ptp(one.waypoints, axis=0)) == 1
