"""Links by serial number: what a calibration found goes with the link, wherever it is mounted."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fss_arm_calib.links import main
from fss_arm_calib.result import SCHEMA
from fss_arm_model.description import Known, paper_arm
from fss_arm_model.description_file import UNKNOWN_ANGLE_SIGMA, load, save, to_yaml
from fss_arm_model.parameters import parameter_names
from fss_arm_ros.command_line import USER_ERROR

SERIALS = 7, 8, 9, 10


def named(arm, serials=SERIALS):
    links = zip(arm.links, serials, strict=True)
    return replace(arm, links=tuple(replace(link, serial=k) for link, k in links))


def result(path, arm, day=1, **changes):
    """A result of a calibration that left this arm."""
    names = [f"{name}_{i}" for name in ("a", "b") for i in range(1, arm.n + 1)]
    values = [link.a for link in arm.links] + [link.b for link in arm.links]
    found = {
        "schema": SCHEMA,
        "kind": "joint",
        "verdict": "pass",
        "description": to_yaml(arm),
        "names": names,
        "values": values,
        "deviations": [1e-4] * len(names),
        "provenance": {"end": day * 86_400 * 10**9, "source": f"bag_{day}"},
        **changes,
    }
    path.write_text(json.dumps(found))
    return str(path)


@pytest.fixture
def arm_file(tmp_path):
    path = tmp_path / "arm.yaml"
    save(named(paper_arm()), path)
    return path


def calibrated():
    arm = named(paper_arm())
    links = (replace(link, a=link.a + 1e-4 * i) for i, link in enumerate(arm.links, 1))
    return replace(arm, links=tuple(links))


def knowing(arm):
    """An arm of which a calibration knows much, each value to another deviation."""
    names = [name for name in parameter_names(arm.n) if name != "m_0"]
    root = np.random.default_rng(3).normal(size=(len(names), len(names)))
    return replace(arm, known=Known.of(names, 1e-8 * root @ root.T))


def test_a_result_goes_to_the_links_files_and_follows_a_link_to_another_place(arm_file, tmp_path):
    found = knowing(calibrated())
    assert main([str(arm_file), "--result", result(tmp_path / "r.json", found)]) == 0
    assert load(arm_file) == found
    before = {link.serial: link for link in found.links}
    text = arm_file.read_text()
    arm_file.write_text(text.replace("[7, 8, 9, 10]", "[7, 9, 8, 10]"))
    assert list(load(arm_file).links) == [before[k] for k in (7, 9, 8, 10)]
    known = load(arm_file).known
    then, now = ["a_2", "I_0", "b_3", "theta_0_2"], ["a_3", "I_0", "b_2", "theta_0_3"]
    before = found.known.covariance_of(then, np.zeros(4))
    assert np.array_equal(known.covariance_of(now, np.zeros(4)), before)
    arm_file.write_text(text.replace("[7, 8, 9, 10]", "[7, 8, 10]"))
    assert set(load(arm_file).known.names) == set(parameter_names(3)) - {"m_0"}


def test_if_another_link_is_first_its_angle_and_the_mounts_are_not_known(arm_file, tmp_path):
    found = knowing(calibrated())
    main([str(arm_file), "--result", result(tmp_path / "r.json", found)])
    arm_file.write_text(arm_file.read_text().replace("[7, 8, 9, 10]", "[8, 7, 10, 9]"))
    known = load(arm_file).known
    names = ["theta_BJ1", "theta_0_2", "theta_0_3"]
    sigma = np.sqrt(np.diag(known.covariance_of(names, np.zeros(3))))
    assert sigma[:2] == pytest.approx(UNKNOWN_ANGLE_SIGMA)
    assert sigma[2] == found.known.covariance_of(["theta_0_4"], np.zeros(1))[0, 0] ** 0.5
    assert "theta_0_1" not in known.names


def test_the_first_link_keeps_its_joints_offset_when_it_is_calibrated(arm_file, tmp_path):
    main([str(arm_file), "--result", result(tmp_path / "r.json", calibrated())])
    text = arm_file.read_text()
    arm_file.write_text(text.replace("[7, 8, 9, 10]", "[8, 7, 9, 10]"))
    moved = load(arm_file)
    found = replace(moved, base=replace(moved.base, mount=(0.2, 0.0, 0.5)))
    main([str(arm_file), "--result", result(tmp_path / "r2.json", found, day=2)])
    assert load(arm_file).base.mount == pytest.approx(found.base.mount, abs=1e-15)
    assert load(arm_file).links == found.links
    arm_file.write_text(arm_file.read_text().replace("[8, 7, 9, 10]", "[7, 8, 9, 10]"))
    assert load(arm_file).links[1].theta_0 == paper_arm().links[1].theta_0


def test_links_are_listed_with_how_they_have_changed(arm_file, tmp_path, capsys):
    main([str(arm_file), "--result", result(tmp_path / "r.json", named(paper_arm()))])
    again = result(tmp_path / "r2.json", calibrated(), day=2)
    for _ in range(2):  # no calibration is told twice
        capsys.readouterr()
        assert main([str(arm_file), "--result", again]) == 0
    out = capsys.readouterr().out
    assert out.count("1970-01-02") == out.count("1970-01-03") == 4
    assert "+2.1 sigma" in out
    arm_file.write_text(arm_file.read_text().replace("[7, 8, 9, 10]", "[7, 8, 9]"))
    main([str(arm_file)])
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["10", "-"] in [[row[1], row[3]] for row in rows if len(row) > 3]


def test_links_that_have_no_file_yet_are_listed_as_well(arm_file, tmp_path, capsys):
    assert main([str(arm_file)]) == 0
    out = capsys.readouterr().out
    assert all(unit in out for unit in ("a [m]", "theta_0", "[rad]", "m [kg]", "I [kg"))
    rows = [line.split() for line in out.splitlines()]
    assert ["7", "1", "now"] in [row[1:6:2] for row in rows if len(row) > 6]


OTHERS = "serials of the links in the result is [7, 9, 8, 10], expected [7, 8"
NAMELESS = "serials of the links is [0, 0, 0, 0], expected one "


@pytest.mark.parametrize(
    ("serials", "of_result", "changes", "message"),
    [
        (SERIALS, (7, 9, 8, 10), {}, OTHERS),
        (SERIALS, SERIALS, {"verdict": "fail"}, "verdict is 'fail', expected pass"),
        ((0, 0, 0, 0), (0, 0, 0, 0), {}, NAMELESS + "for each"),
        ((0, 0, 0, 0), None, {}, NAMELESS + "at least"),
    ],
)
def test_what_does_not_belong_is_refused(tmp_path, capsys, serials, of_result, changes, message):
    path, given = tmp_path / "arm.yaml", []
    save(named(paper_arm(), serials), path)
    before = path.read_text()
    if of_result:
        given = ["--result", result(tmp_path / "r.json", named(paper_arm(), of_result), **changes)]
    assert main([str(path), *given]) == USER_ERROR
    assert message in capsys.readouterr().err
    assert path.read_text() == before
    assert not list(tmp_path.glob("link_*"))
