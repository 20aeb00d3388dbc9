import math
import os
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from model_arms import random_arm
from running import run_command

import fss_arm_model
from fss_arm_model.description import (
    Arm,
    Base,
    Drive,
    Link,
    TorqueSensor,
    paper_arm,
)
from fss_arm_model.description_fields import DescriptionError
from fss_arm_model.description_file import described, from_yaml, load, save, to_yaml
from fss_arm_model.layout import kinematic_index, kinematic_names
from fss_arm_model.parameters import combination_gradients, describe_symbols

CONFIG = Path(__file__).parents[3] / "config"


@pytest.mark.parametrize(
    ("name", "number"),
    [("a: #b \u00e9", 1e-05), ("yes", 1.7e308), ("1.0", 5e-324), ("null", 0.1 + 0.2), ("'", 1e16)],
)
def test_yaml_gives_the_same_arm_back(name, number):
    drive = Drive(7, -1, torque_constant=number, max_current=1.5e22, max_velocity=0.1)
    angle = min(number, 6.1 + 0.1)
    limited = {"q_min": -angle, "q_max": angle, "a": number, "lateral": -number}
    sensor = TorqueSensor(gain=-number, zero=number)
    arm = random_arm(2, np.random.default_rng(1))
    links = tuple(replace(k, **limited, drive=drive, torque_sensor=sensor) for k in arm.links)
    arm = replace(arm, name=name, links=links, base=replace(arm.base, com=(number, -number)))
    assert from_yaml(to_yaml(arm)) == arm


def test_defaults_need_not_be_written():
    link = "{a: 38e-2, theta_0: 0, mass: 3, inertia: 3e-2, b: 0.2}"
    arm = from_yaml(f"name: short\nbase: {{mass: 10, inertia: .25}}\nlinks: [{link}]")
    assert arm == Arm("short", Base(10.0, 0.25), (Link(0.38, 0.0, 3.0, 0.03, 0.2),))
    assert isinstance(arm.links[0].mass, float)


WRONG = [
    # where in the paper's description, value, field as named, what was expected
    (["base", "mass"], -1.0, "base: mass", "a positive number [kg]"),
    (["base", "inertia"], math.nan, "base: inertia", "a positive number [kg m^2]"),
    (["base", "com"], [0.0], "base: com", "two finite numbers (x, y) [m]"),
    (["base", "mount"], [0.0, math.inf, 0.0], "base: mount", "three finite numbers"),
    (["links", 1, "inertai"], 0.03, "link 2: inertai", "the entry inertia"),
    (["base", "mount"], [0.2058, 0.0155, 18.211], "base: mount", "-6.283 to 6.283 [rad]"),
    (["base", "wheels"], 4, "base: wheels", "only the entries mass, inertia, com, mount"),
    (["base"], 3, "base", "a base"),
    (["theta_E"], [0.1], "theta_E", "a finite number [rad]"),
    (["name"], "", "name", "a printable text that is not empty"),
    (["links"], 4, "links", "a list of links"),
    (["links", 1, "drive"], None, "link 2: drive", "a drive"),
    (["links"], [], "links", "1 to 12 links"),
    (["links"], 13 * [yaml.safe_load(to_yaml(paper_arm()))["links"][0]], "links", "1 to 12 links"),
    (["links", 0, "theta_0"], 0.1, "link 1: theta_0", "0, as theta_BJ1 takes its place"),
    (["links", 1, "a"], 0.0, "link 2: a", "a positive number [m]"),
    (["links", 3, "q_max"], -2.0, "link 4: q_max", "more than q_min = -1.5707963267948966 [rad]"),
    (["links", 0, "q_min"], -90.0, "link 1: q_min", "in degrees? -90 deg are -1.571 rad"),
    (["links", 1, "theta_0"], 6.3, "link 2: theta_0", "-6.283 to 6.283 [rad]; in degrees?"),
    (["theta_E"], -180, "theta_E", "-6.283 to 6.283 [rad]; in degrees?"),
    (["links", 1, "drive", "direction"], 0, "link 2: drive: direction", "1 or -1"),
    (["links", 1, "drive", "counts_per_turn"], 2.5, "link 2: drive: counts_per_turn", "integer"),
    (["links", 1, "torque_sensor", "gain"], 0.0, "link 2: torque_sensor: gain", "other than zero"),
]


@pytest.mark.parametrize(("where", "value", "field", "expected"), WRONG)
def test_wrong_entry_is_named_with_value_and_expectation(where, value, field, expected):
    description = yaml.safe_load(to_yaml(paper_arm()))
    part = description
    for key in where[:-1]:
        part = part[key]
    part[where[-1]] = value
    with pytest.raises(DescriptionError) as caught:
        from_yaml(yaml.safe_dump(description))
    error = caught.value
    assert error.field == field
    assert expected in error.expected
    given = "missing" if value is None else repr(error.value)
    assert (
        str(error)
        == f"{field} is {given[:77]}{'...' * (len(given) > 80)}, expected {error.expected}"
    )


@pytest.mark.parametrize(
    ("was", "becomes", "words"),
    [
        ("a: 0.4", "a: 400", "link 2: a is 400.0, expected at most 10 [m]; in millimetres?"),
        ("mass: 3", "mass: 3000", "link 2: mass is 3000.0, expected at most 1000 [kg]; in grams?"),
        ("b: 0.2", "b: -200", "link 2: b is -200.0, expected at most 10 [m]; in millimetres?"),
        ("mass: 12", "mass: 12e3", "base: mass is 12000.0, expected at most 1000 [kg]; in grams?"),
        (
            "inertia: 0.04",
            "inertia: 400",
            "link 2: inertia is 400.0, expected at most 12 [kg m^2] with this mass; in kg cm^2?",
        ),
    ],
)
def test_a_file_in_other_units_is_refused(tmp_path, was, becomes, words):
    link = "{a: 0.4, theta_0: 0.0, mass: 3, inertia: 0.04, b: 0.2}"
    text = (
        f"name: mine\nbase: {{mass: 12, inertia: 0.3}}\nlinks: [{link.replace('4', '3')}, {link}]"
    )
    file = tmp_path / "arm.yaml"
    file.write_text(text)
    assert load(file).n == 2
    file.write_text(was.join(text.split(was)[:-1]) + becomes + text.split(was)[-1])
    with pytest.raises(DescriptionError) as caught:
        load(file)
    assert str(caught.value) == f"{file}: {words}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "arm is missing, expected the entries name, base, links, theta_E"),
        ("name: [", "line "),
        ("name: 2020-13-45", "text is"),
        ("{[1]: 2}", "line 1 is"),
        ("name: !!python/object:os.system x", "line 1 is"),
        ("name: x\nname: y", "name is 'given twice', expected once"),
        ("name: x\nlinks: []", "base is missing, expected a base"),
    ],
)
def test_text_that_is_no_description_is_refused_in_one_line(text, message):
    with pytest.raises(DescriptionError, match=f"^{re.escape(message)}") as caught:
        from_yaml(text)
    assert "\n" not in str(caught.value)


def test_load_names_the_file(tmp_path):
    file = tmp_path / "arm.yaml"
    file.write_bytes(b"\xff")
    with pytest.raises(
        DescriptionError, match=rf"^{file}: byte 0 is 'invalid start byte', expected UTF-8"
    ):
        load(file)
    file.write_text(to_yaml(paper_arm()).replace("mass: 10.0", "mass: -10.0"))
    with pytest.raises(DescriptionError, match=rf"^{file}: base: mass is -10.0, expected a pos"):
        load(file)


def test_vector_and_kinematic_names_follow_the_paper():
    p = paper_arm().vector()
    assert p[:8] == pytest.approx([10.0, 0.25, 0.0, 0.0, 0.2058, 0.0155, math.radians(18.211), 0])
    assert p[14:20] == pytest.approx([0.3825, math.radians(5.801), 2.88, 0.034, 0.1915, 0.0])
    assert p.shape == (8 + 6 * 4,)
    assert " ".join(kinematic_names(2)) == "a_1 a_2 theta_0_2 x_BJ1 y_BJ1 theta_BJ1"
    values = dict(zip(kinematic_names(4), p[kinematic_index(4)], strict=True))
    assert values["a_4"] == 0.3351
    assert math.degrees(values["theta_0_3"]) == pytest.approx(-3.402)


@pytest.mark.parametrize("n", [1, 4])
def test_kinematic_parameters_are_part_of_the_vector(n):
    arm = random_arm(n, np.random.default_rng(n))
    xi = arm.vector()[kinematic_index(n)]
    assert len(kinematic_names(n)) == len(xi) == 2 * n + 2
    assert arm.with_kinematics(xi) == arm
    other = arm.with_kinematics(xi + 0.01)
    assert other.vector()[kinematic_index(n)].tolist() == (xi + 0.01).tolist()
    assert [k.b for k in other.links] == [k.b for k in arm.links]


def test_kinematic_parameters_that_cannot_be_are_refused():
    xi = paper_arm().vector()[kinematic_index(4)]
    with pytest.raises(DescriptionError, match="expected 10 numbers"):
        paper_arm().with_kinematics(xi[1:])
    xi[1] = -0.38
    with pytest.raises(DescriptionError, match=r"link 2: a is -0.38, expected a positive"):
        paper_arm().with_kinematics(xi)


def test_default_description_is_the_papers():
    assert load(CONFIG / "arm.yaml") == paper_arm()
    assert (CONFIG / "arm.yaml").read_text() == to_yaml(paper_arm())


@pytest.mark.parametrize("name", ["paper", "cad", "truth"])
def test_an_arm_is_found_by_its_name_as_by_its_file(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert described(name).name == name
    save(described(name), tmp_path / "copy")
    assert described("copy") == described(str(tmp_path / "copy")) == described(name)


def test_a_name_that_nobody_knows_is_answered_with_those_there_are():
    with pytest.raises(DescriptionError, match=r"^arm is 'cda', expected .* paper, cad, truth$"):
        described("cda")
    with pytest.raises(FileNotFoundError):
        described("cda.yaml")
    assert described("") == paper_arm()


def test_an_installed_copy_finds_the_descriptions_in_share(tmp_path):
    package = tmp_path / "lib/python3/site-packages/fss_arm_model"
    shutil.copytree(Path(fss_arm_model.__file__).parent, package)
    shutil.copytree(CONFIG, tmp_path / "share/fss_arm_model/config")
    program = "from fss_arm_model.description_file import described; print(described('truth').name)"
    path = {**os.environ, "PYTHONPATH": str(package.parent)}
    run = run_command(sys.executable, "-c", program, cwd="/", env=path)
    assert run.stdout == "truth\n", run.stderr


def test_gradients_of_combined_parameters_are_finite_differences():
    arm = paper_arm()
    combined, G = combination_gradients(arm)
    for name, column, h in (("mass", 14, 1e-6), ("b", 18, 1e-7), ("inertia", 22, 1e-7)):
        for i, link in enumerate(arm.links):
            links = list(arm.links)
            links[i] = replace(link, **{name: getattr(link, name) + h})
            there = combination_gradients(replace(arm, links=tuple(links)))[0]
            assert (there - combined) / h == pytest.approx(G[:, column + i], rel=0, abs=1e-5)


# --- links by serial number -----------------------------------------------------------------------


def filed(folder, serials):
    """A description by serial numbers, and the links' files beside it."""
    for i, link in enumerate(paper_arm().links):
        given = {
            **{key: getattr(link, key) for key in ("a", "b", "mass", "inertia")},
            "theta_0": 0.01 * (i + 1),
            "serial": i + 7,
            "history": [{"date": "2026-11-23"}],
        }
        (folder / f"link_{i + 7}.yaml").write_text(yaml.safe_dump(given))
    base = {"mass": 10.0, "inertia": 0.25, "mount": [0.2, 0.0, 0.3]}
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump({"name": "filed", "base": base, "links": serials}))
    return path


def test_links_that_are_moved_take_their_values_along(tmp_path):
    """Reordering the list moves everything that is a link's own, its joint's offset as well."""
    path = filed(tmp_path, [7, 8, 9, 10])
    before, after = load(path), load(filed(tmp_path, [10, 8, 7, 9]))
    offsets = {7: 0.01, 8: 0.02, 9: 0.03, 10: 0.04}
    own = {link.serial: replace(link, theta_0=0.0) for link in before.links}
    assert [link.serial for link in after.links] == [10, 8, 7, 9]
    assert [replace(link, theta_0=0.0) for link in after.links] == [own[k] for k in (10, 8, 7, 9)]
    assert [link.theta_0 for link in after.links[1:]] == [offsets[k] for k in (8, 7, 9)]
    assert after.base.mount[2] == pytest.approx(0.3 + offsets[10])
    assert [link.a for link in before.links] == [link.a for link in paper_arm().links]
    assert from_yaml(to_yaml(after)) == after


@pytest.mark.parametrize(
    ("serials", "message"),
    [
        ([7, 8, 7], r"serials of the links is \[7, 8, 7\], expected each once"),
        ([7, 11], r"links is 'link_11.yaml', expected a file: No such file or directory"),
    ],
)
def test_serial_numbers_that_cannot_be_right_are_refused(tmp_path, serials, message):
    with pytest.raises(DescriptionError, match=message):
        load(filed(tmp_path, serials))


def test_a_link_file_of_another_serial_number_is_refused(tmp_path):
    path = filed(tmp_path, [7, 11])
    shutil.copy(tmp_path / "link_8.yaml", tmp_path / "link_11.yaml")
    with pytest.raises(DescriptionError, match=r"link_11\.yaml: serial is 8, expected the number"):
        load(path)


@pytest.mark.parametrize(
    ("names", "symbols"),
    [
        (("b_1", "b_#8", "I_0"), ["I", "b", "0"]),
        (("theta_0_2", "theta_BJ1", "theta_E"), ["theta_0", "BJ1", "theta_E"]),
        (("a", "m", "x_com"), ["m", "x_com, y_com", "a"]),
        (("g_x", "drag"), ["g_x, g_y"]),
    ],
)
def test_symbols_of_parameters_are_described(names, symbols):
    found = [one for one in describe_symbols(names).split("; ") if one]
    assert [one.split(":")[0] for one in found] == symbols
