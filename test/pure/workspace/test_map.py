"""The command `map`: figures, numbers and errors; calibrations of the described arm."""

from dataclasses import replace

import numpy as np
import pytest
from calib_kinds import serialized
from model_arms import short_arm

from fss_arm_bags.reader import BagError
from fss_arm_bags.recorder import Recording
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import from_yaml, save, to_yaml
from fss_arm_model.layout import kinematic_index
from fss_arm_msgs.msg import Calibration, DynamicCalibration, KinematicCalibration
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.qos import LATCHED
from fss_arm_workspace.analysis import load_kernels
from fss_arm_workspace.calibrations import Calibrations
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
    assert main([str(short_arm(1, tmp_path)), "--output", str(tmp_path)]) == 0
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
        (
            ["--table", "1", "1", "0", "2"],
            "table_corners is (1.0, 1.0, 0.0, 2.0) m, expected low x",
        ),
        (["--table", "5", "5", "6", "6"], "expected on the table"),
        (["--start", "10", "20"], "--start has 2 angles, expected 4"),
        (["--start", "100", "0", "0", "0"], "joint 1 starts at 100 deg, expected"),
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
    covariance = (deviation**2 * np.eye(len(names))).ravel().tolist()
    found = {"verdict": "pass", "description": to_yaml(arm), "names": names}
    return kind(calibration=Calibration(covariance=covariance, **found))


FAILED = KinematicCalibration(calibration=Calibration(verdict="fail"))


def longer(share):
    """Return the paper's arm with longer links and offsets."""
    arm = paper_arm()
    return arm.with_kinematics(arm.vector()[kinematic_index(arm.n)] * share)


def test_passed_calibrations_are_used_with_their_covariance_in_any_order():
    """A dynamic calibration assumes the kinematics, unless it estimates them."""
    arm = paper_arm()
    assert Calibrated(arm).with_message("calibration/kinematic", FAILED) == Calibrated(arm)
    heavy = from_yaml(to_yaml(arm).replace("inertia: 0.034", "inertia: 0.05"))
    dynamic = "calibration/dynamic", passed(DynamicCalibration, heavy, ["I"], 2e-3)
    kinematic = "calibration/kinematic", passed(KinematicCalibration, longer(1.01), ["a_1"], 1e-3)
    one = Calibrated(arm).with_message(*dynamic).with_message(*kinematic)
    other = Calibrated(arm).with_message(*kinematic).with_message(*dynamic)
    for known in (one, other):
        assert [link.inertia for link in known.arm.links] == [0.05] * 4
        assert [link.a for link in known.arm.links] == [link.a for link in longer(1.01).links]
        assert np.sqrt(np.diag(known.covariance)[[8, 11]]) == pytest.approx([1e-3, 2e-3])
    assert np.array_equal(one.covariance, other.covariance)
    both = passed(DynamicCalibration, heavy, ["a_1"], 5e-3)
    newest = other.with_message("calibration/dynamic", both)
    assert newest.arm == heavy
    assert np.sqrt(newest.covariance[8, 8]) == pytest.approx(5e-3)


def with_mass(mass):
    arm = paper_arm()
    return replace(arm, links=(*arm.links[:3], replace(arm.links[3], mass=mass)))


def test_the_newest_of_each_kind_counts_and_that_of_another_arm_changes_nothing():
    arm, calibrations = paper_arm(), Calibrations(Calibrated(paper_arm()))
    for kind, found in (("dynamic", with_mass(3.0)), ("kinematic", arm), ("dynamic", with_mass(2))):
        calibrations.add(f"calibration/{kind}", passed(DynamicCalibration, found, [], 0.0))
    assert list(calibrations.messages) == ["calibration/kinematic", "calibration/dynamic"]
    assert calibrations.calibrated.arm == with_mass(2.0)
    shorter = passed(KinematicCalibration, replace(arm, links=arm.links[:3]), [], 0.0)
    with pytest.raises(ValueError, match="it is for 3 links, expected 4"):
        calibrations.add("calibration/kinematic", shorter)
    assert calibrations.messages["calibration/kinematic"] is not shorter
    assert calibrations.calibrated.arm == with_mass(2.0)


def test_the_last_passed_calibration_of_a_bag_is_used(tmp_path):
    found = [passed(KinematicCalibration, longer(x), ["a", "a_4"], 1e-3) for x in (1.01, 1.02)]

    def recorded(name, messages):
        bag = Recording(tmp_path / name)
        bag.add(TOPIC, "fss_arm_msgs/msg/KinematicCalibration", [LATCHED])
        for t, message in enumerate(messages, 1):
            bag.write(TOPIC, t, serialized(message))
        bag.close()
        return [str(bag.path)]

    known = load_arm(recorded("passed", [*found, FAILED]))
    assert known.arm == longer(1.02)
    assert np.sqrt(known.covariance[8, 8]) == pytest.approx(1e-3)
    with pytest.raises(BagError, match="no calibration that passed"):
        load_arm(recorded("failed", [FAILED]))
