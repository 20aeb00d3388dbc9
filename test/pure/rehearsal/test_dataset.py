"""The data set: a bag as drivers record it, its truth and hashes, and the table of results."""

from hashlib import sha256
from itertools import pairwise

import numpy as np
import pytest

from fss_arm_bags.reader import open_bags
from fss_arm_model.description_file import load, save
from fss_arm_model.layout import kinematic_index
from fss_arm_model.parameters import parameter_names, values
from fss_rehearsal.dataset import least_squares
from fss_rehearsal.dataset.arms import BLIND, LINKS, ArmPair, draw_pair
from fss_rehearsal.dataset.bags import KINDS, plan, record
from fss_rehearsal.dataset.command import main
from fss_rehearsal.dataset.results import (
    OWN_METHOD,
    PLAIN_METHOD,
    Estimates,
    compare,
    evaluate,
    results_table,
)
from fss_rehearsal.dataset.sheet import markdown, write_checksums


def test_descriptions_have_the_errors_of_drawings_and_nominal_drives():
    for name, n in LINKS.items():
        pair = draw_pair(name, 3)
        off = dict(
            zip(parameter_names(n), values(pair.described) - values(pair.truth), strict=True)
        )
        assert 0.0 < abs(off["a_1"]) < 0.005
        assert 0.0 < abs(off["b_1"]) < 0.015
        assert abs(off["I_1"]) < 0.25 * pair.truth.links[0].inertia
        drives = {link.drive.torque_constant for link in pair.described.links}
        assert drives == {0.8} != {link.drive.torque_constant for link in pair.truth.links}
        assert draw_pair(name, 3) == pair != draw_pair(name, 4)


def test_a_kinematic_bag_is_calibrated_by_both_methods(tmp_path):
    """Without errors of the instruments, both find the truth; a drift needs no move of the arm."""
    pair = draw_pair("a", 5)
    description = tmp_path / "a.yaml"
    save(pair.described, description)
    planned = plan("kinematic", pair.described, 0)
    record(tmp_path / "kinematic", "kinematic", "ideal", pair, planned, 6)
    with open_bags(tmp_path / "kinematic") as bags:
        topics = {topic for topic, *_ in bags.messages()}
    assert topics == {
        *("/joint_states", "/vicon/fss/fss", "/vicon/end_effector/end_effector", "/fog/imu"),
        *("/link_1/telemetry", "/link_2/telemetry"),
    }
    streams = least_squares.read(tmp_path / "kinematic")
    rests = least_squares.rests(streams, "/vicon/fss/fss", "/vicon/end_effector/end_effector")
    start, true = (arm.vector()[kinematic_index(2)] for arm in (pair.described, pair.truth))
    found, _ = least_squares.fit(*rests, start)
    assert np.abs(found - true).max() < 1e-4  # interpolated between samples of moving joints
    assert np.abs(start - true).max() > 1e-3


def test_errors_are_those_of_determined_parameters_and_angles_are_wrapped():
    true = {"a_1": 0.3, "theta_0_2": 3.1, "b_1": 0.1}
    names, errors, deviations = compare(
        ("a_1", "theta_0_2", "b_1", "other"),
        np.array([0.301, -3.1, 0.2, 1.0]),
        np.array([0.001, 0.1, np.inf, 1.0]),
        true,
    )
    assert names == ("a_1", "theta_0_2")
    np.testing.assert_allclose(errors, [0.001, 2.0 * np.pi - 6.2])
    np.testing.assert_allclose(deviations, [0.001, 0.1])


def test_the_table_has_a_row_for_each_kind_preset_and_method():
    def estimates(method, error, passed):
        ones = np.ones(2)
        names = "a_1", "theta_0_2"
        return Estimates("kinematic", "ideal", method, passed, 1.5, names, error * ones, ones)

    head, own, plain = results_table(
        [
            estimates(OWN_METHOD, 0.5, True),
            estimates(OWN_METHOD, -3.0, False),
            estimates(PLAIN_METHOD, 0.1, True),
        ]
    )
    assert own == [
        *("kinematic", "ideal", OWN_METHOD, "1 of 2", "2", "5e+02 mm, 29 deg"),
        *("100 %", "0.50", "1.5"),
    ]
    assert plain[3] == ""
    lines = markdown([head, own, plain]).splitlines()
    assert len(lines) == 4
    assert all(a.count("|") == b.count("|") for a, b in pairwise(lines))


def test_checksums_are_those_of_sha256sum(tmp_path):
    file = tmp_path / "truth" / "d.yaml"
    file.parent.mkdir()
    file.write_text("arm")
    write_checksums(tmp_path / "sums", tmp_path, [file])
    digest = sha256(b"arm").hexdigest()
    assert (tmp_path / "sums").read_text() == f"{digest}  truth/d.yaml\n"


def test_an_existing_folder_is_kept(tmp_path, capsys):
    assert main([str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"dataset.sh: {tmp_path} exists, give a new folder\n"


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["ideal", "laboratory"])
def test_each_calibration_finds_the_truth_from_its_bag(preset, tmp_path):
    pair: ArmPair = draw_pair("b", 7)
    save(pair.described, tmp_path / "b.yaml")
    save(pair.truth, tmp_path / "truth.yaml")
    assert load(tmp_path / "truth.yaml") == pair.truth
    for k, kind in enumerate(KINDS):
        record(tmp_path / kind, kind, preset, pair, plan(kind, pair.described, 7), 10 + k)
    for one in evaluate(tmp_path, tmp_path / "b.yaml", preset, pair):
        ratios = np.abs(one.errors / one.deviations)
        print(one.kind, one.method, one.passed, dict(zip(one.names, ratios.round(1), strict=True)))
        # In `laboratory` the torque gain of a light link may be uncertain by more than 10 %.
        assert one.passed or (one.kind, preset) == ("drives", "laboratory")
        assert len(one.names) >= 5
        assert ratios.max() < 5.0
    assert set(BLIND) < set(LINKS)
