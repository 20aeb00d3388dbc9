"""The command `drives`, from a bag to the calibrated description, and the plan it asks for."""

import json
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from calib_drives import excitation, fly
from rclpy.serialization import serialize_message

from fss_arm_bags.recorder import Recording
from fss_arm_calib.drives.drives_command import main
from fss_arm_calib.experiment.design import from_yaml
from fss_arm_calib.experiment.design_command import main as design
from fss_arm_model.description import described, load, to_yaml
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames a second of each link of the true arm."""
    arm = described("truth")
    flown = fly(arm, excitation(arm.n, np.random.default_rng(0)), seed=0)
    recording = Recording(tmp_path_factory.mktemp("drives"))
    for i, one in enumerate(flown.telemetry, 1):
        topic = f"/link_{i}/telemetry"
        recording.add(topic, "fss_arm_msgs/msg/LinkTelemetry", [SENSOR])
        for k, stamp in enumerate(one.stamp.tolist()):
            message = LinkTelemetry(link=i, boot=1, homings=1)
            message.header.stamp = Time(sec=stamp // 10**9, nanosec=stamp % 10**9)
            for name in ("position", "velocity", "current", "torque", "torque_age"):
                setattr(message, name, int(getattr(one, name)[k]))
            recording.write(topic, stamp, serialize_message(message))
    recording.close()
    return recording.path


def test_a_bag_tells_the_drives(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, result = tmp_path / "arm.yaml", tmp_path / "drives.json"
    asked = ["--arm", "truth", "--truth", str(described_truth(tmp_path)), "--max-relative", "0.2"]
    code = main([str(bag), *asked, "--output", str(output), "--result", str(result)])
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
    assert reasons["dead_band_1"].startswith("dead_band_1 refused: the encoder is on the motor")


def described_truth(folder: Path) -> Path:
    """The true arm as a file."""
    path = folder / "truth.yaml"
    path.write_text(to_yaml(described("truth")))
    return path


def test_a_bag_without_telemetry_is_refused(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(bag), "--namespace", "other"]) == 1
    assert "no link's telemetry" in capsys.readouterr().err


def test_design_proposes_moves_of_single_joints(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    assert design(["--kinds", "joint", "--repeats", "1", "--output", str(path)]) == 0
    plan = from_yaml(path.read_text(), 4)
    assert len(plan) == 8
    for one in plan:
        assert np.count_nonzero(np.ptp(one.waypoints, axis=0)) == 1
