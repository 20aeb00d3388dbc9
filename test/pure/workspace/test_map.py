"""The command `map`: figures, numbers and errors."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from fss_arm_bags.reader import BagError
from fss_arm_bags.recorder import Recording
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import from_yaml, save, to_yaml
from fss_arm_msgs.msg import Calibration, DynamicCalibration, KinematicCalibration
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.qos import LATCHED
from fss_arm_workspace.analysis import load_kernels
from fss_arm_workspace.map import load_arm, main
from fss_arm_workspace.regions.fixed import fixed_workspace

TOPIC = "/calibration/kinematic"


@pytest.mark.slow
def test_figures_and_their_numbers_are_written(tmp_path, capsys):
    save(paper_arm(), tmp_path / "arm.yaml")
    folder = tmp_path / "out"
    assert main([str(tmp_path / "arm.yaml"), "--output", str(folder), "--cell", "0.1"]) == 0
    for number in (6, 7, 8):
        assert (folder / f"figure_{number}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (folder / f"figure_{number}.svg").read_text()
    with np.load(folder / "workspace.npz") as data:
        assert from_yaml(str(data["arm"])) == paper_arm()
        assert data["area"] == fixed_workspace(paper_arm()).area
        assert data["radius"] == pytest.approx(1.172, abs=5e-4)
        assert np.nanmax(data["map_fixed"]) > 3.0 * np.nanmax(data["map_floating"]) > 0.0
        assert len(data["straight_floating"]) >= 360
    said = capsys.readouterr().out
    assert "R = 1.1721 m" in said
    assert "17.07 kg" in said


@pytest.mark.slow
def test_a_single_link_has_no_maps(tmp_path, capsys):
    save(replace(paper_arm(), links=paper_arm().links[:1]), tmp_path / "arm.yaml")
    assert main([str(tmp_path / "arm.yaml"), "--output", str(tmp_path)]) == 0
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == ["figure_7", "figure_8"]
    with np.load(tmp_path / "workspace.npz") as data:
        assert data["area"] == pytest.approx(0.0, abs=1e-12)
        assert data["reach"][1] == pytest.approx(data["radius"])
    assert "largest w" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("args", "error"),
    [
        (["/no/such.yaml"], "No such file"),
        (["/no/such/bag"], "no such file or folder"),
        (["--cell", "0"], "cell is 0.0 m, expected 0.001 or more"),
        (["--table", "1", "1", "0", "2"], "table is (1.0, 1.0, 0.0, 2.0) m, expected low x"),
        (["--table", "5", "5", "6", "6"], "expected on the table"),
        (["--start", "10", "20"], "--start has 2 angles, expected 4"),
        (["--start", "100", "0", "0", "0"], "joint 1 starts at 1.74533 rad"),
    ],
)
def test_user_errors_are_reported_in_one_line(tmp_path, capsys, args, error):
    assert main([*args, "--output", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert error in said
    assert said.count("\n") == 1


LINK = paper_arm().links[0]


@pytest.mark.parametrize(
    "links", [(LINK,), (LINK,) * 10, (replace(LINK, q_min=-1.0, q_max=-0.5),) * 3]
)
def test_kernels_are_loaded_for_any_arm(links):
    """Arms with one link, with a tip beyond the table, and without room for an arch."""
    load_kernels(replace(paper_arm(), links=links))


def passed(kind, arm, names, deviation):
    size = len(names)
    covariance = (deviation**2 * np.eye(size)).ravel().tolist()
    return kind(
        calibration=Calibration(
            verdict="pass", description=to_yaml(arm), names=names, covariance=covariance
        )
    )


def test_a_passed_calibration_is_used_with_its_covariance():
    arm = paper_arm()
    longer = arm.with_kinematics(arm.vector()[[8, 14, 20, 26, 15, 21, 27, 4, 5, 6]] * 1.01)
    known = Calibrated(arm)
    assert (
        known.with_message(
            "calibration/kinematic", KinematicCalibration(calibration=Calibration(verdict="fail"))
        )
        == known
    )
    kinematic = passed(KinematicCalibration, longer, ["a", "a_4"], 1e-3)
    known = known.with_message("calibration/kinematic", kinematic)
    assert known.arm == longer
    assert np.sqrt(known.covariance[8, 8]) == pytest.approx(1e-3)


def test_a_later_kinematic_calibration_keeps_the_masses():
    arm = paper_arm()
    kinematics = arm.vector()[[8, 14, 20, 26, 15, 21, 27, 4, 5, 6]]
    heavy = from_yaml(to_yaml(arm).replace("inertia: 0.034", "inertia: 0.05"))
    longer = arm.with_kinematics(kinematics * 1.01)
    dynamic = passed(DynamicCalibration, heavy, ["I"], 2e-3)
    kinematic = passed(KinematicCalibration, longer, ["a_1"], 1e-3)
    known = Calibrated(arm).with_message("calibration/dynamic", dynamic)
    known = known.with_message("calibration/kinematic", kinematic)
    assert [link.inertia for link in known.arm.links] == [0.05] * 4
    assert [link.a for link in known.arm.links] == [link.a for link in longer.links]
    assert np.sqrt(np.diag(known.covariance)[[8, 11]]) == pytest.approx([1e-3, 2e-3])


def test_the_order_of_two_latched_results_does_not_matter():
    """A dynamic calibration assumes the kinematics, unless it estimates them."""
    arm = paper_arm()
    kinematics = arm.vector()[[8, 14, 20, 26, 15, 21, 27, 4, 5, 6]]
    heavy = from_yaml(to_yaml(arm).replace("inertia: 0.034", "inertia: 0.05"))
    longer = arm.with_kinematics(kinematics * 1.01)
    dynamic = "calibration/dynamic", passed(DynamicCalibration, heavy, ["I"], 2e-3)
    kinematic = "calibration/kinematic", passed(KinematicCalibration, longer, ["a_1"], 1e-3)
    one = Calibrated(arm).with_message(*dynamic).with_message(*kinematic)
    other = Calibrated(arm).with_message(*kinematic).with_message(*dynamic)
    assert one.arm == other.arm
    assert np.array_equal(one.covariance, other.covariance)
    both = passed(DynamicCalibration, heavy, ["a_1"], 5e-3)
    newest = other.with_message("calibration/dynamic", both)
    assert newest.arm == heavy
    assert np.sqrt(newest.covariance[8, 8]) == pytest.approx(5e-3)


def serialized(message):
    """Return the bytes that a publisher sends; serialize_message appends some more."""
    message.homings = [0x51525354]
    data, last = serialize_message(message), struct.pack("<I", 0x51525354)
    return data[: data.rindex(last) + len(last)]


def test_the_last_passed_calibration_of_a_bag_is_used(tmp_path):
    arm = paper_arm()
    kinematics = arm.vector()[[8, 14, 20, 26, 15, 21, 27, 4, 5, 6]]
    arms = [arm.with_kinematics(kinematics * share) for share in (1.01, 1.02)]
    messages = [passed(KinematicCalibration, a, ["a", "a_4"], 1e-3) for a in arms]
    bag = Recording(tmp_path / "bag")
    bag.add(TOPIC, "fss_arm_msgs/msg/KinematicCalibration", [LATCHED])
    for t, message in enumerate(
        [*messages, KinematicCalibration(calibration=Calibration(verdict="fail"))], 1
    ):
        bag.write(TOPIC, t, serialized(message))
    bag.close()
    known = load_arm([str(bag.path)])
    assert known.arm == arms[1]
    assert np.sqrt(known.covariance[8, 8]) == pytest.approx(1e-3)


def test_a_bag_without_a_calibration_is_rejected(tmp_path):
    bag = Recording(tmp_path / "bag")
    bag.add(TOPIC, "fss_arm_msgs/msg/KinematicCalibration", [LATCHED])
    bag.write(TOPIC, 1, serialized(KinematicCalibration(calibration=Calibration(verdict="fail"))))
    bag.close()
    with pytest.raises(BagError, match="no calibration that passed"):
        load_arm([str(bag.path)])
