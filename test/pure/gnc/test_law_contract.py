"""The contract of a control law, and the C header that is generated from it."""

import re
import subprocess
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from law_bench import inputs

from fss_gnc.law import Inputs, Outputs
from fss_gnc.law.contract import MAX_JOINTS, STRUCTURES, from_record, members, to_record
from fss_gnc.law.header import STRUCTURE_NAMES, header

LAWS = Path(__file__).parents[3] / "docs/examples/laws"
PAGE = (LAWS.parents[1] / "how-to/controller.md").read_text()
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
TARGET = {"target_pose": np.arange(3.0), "target_twist": np.array([0.1, 0.2, 0.3])}


@pytest.mark.parametrize("joints", [1, MAX_JOINTS])
@pytest.mark.parametrize("changes", [{}, TARGET, {"propellant": None, "valves_armed": False}])
def test_inputs_survive_their_structure(joints, changes):
    given = inputs(joints, **changes)
    got = from_record(Inputs, to_record(given, joints), joints)
    for f in fields(Inputs):
        np.testing.assert_array_equal(getattr(got, f.name), getattr(given, f.name))


@pytest.mark.parametrize(
    "given",
    [
        {}, {"wrench": np.arange(3.0)}, {"valve_on_times": np.arange(8.0)},
        {"joint_positions": np.arange(4.0)}, {"joint_currents": np.arange(4.0)},
        {"joint_velocities": np.arange(4.0), "gripper_closed": False, "wrench": np.zeros(3)},
    ],
)  # fmt: skip
def test_outputs_survive_their_structure(given):
    got = from_record(Outputs, to_record(Outputs(**given), 4), 4)
    for f in fields(Outputs):
        value = getattr(got, f.name)
        assert (value is None) == (f.name not in given)
        np.testing.assert_array_equal(value, given.get(f.name))


def test_contradictory_outputs_are_refused():
    both = {"wrench": np.zeros(3), "valve_on_times": np.zeros(8)}
    with pytest.raises(ValueError, match="wrench and valve_on_times are given"):
        Outputs(**both)
    record = to_record(Outputs(wrench=np.zeros(3)), 4)
    record["valve_on_times_valid"] = 1
    with pytest.raises(ValueError, match="expected at most one"):
        from_record(Outputs, record, 4)


def test_a_wrong_shape_or_number_names_the_command():
    with pytest.raises(ValueError, match=r"joint_velocities has shape \(3,\), expected \(4,\)"):
        to_record(Outputs(joint_velocities=np.zeros(3)), 4)
    with pytest.raises(ValueError, match="joint_currents is"):
        Outputs(joint_currents=np.array([0.0, np.inf])).require_finite()


def test_each_quantity_has_a_meaning_and_a_place_on_the_page_and_each_number_a_unit():
    for kind in (Inputs, Outputs):
        for f in fields(kind):
            assert f"`{f.name}`" in PAGE
            assert f.metadata["about"]
            plain = f.metadata["kind"] is not float or f.name == "base_covariance"
            assert plain or f.metadata["unit"], f.name


def test_the_header_of_the_examples_is_the_generated_one():
    assert (LAWS / "law.h").read_text() == header()


def test_structures_are_laid_out_as_the_c_compiler_does(tmp_path):
    lines = ["#include <stddef.h>", "#include <stdio.h>", '#include "law.h"', "int main(void) {"]
    expected = []
    for kind, name in STRUCTURE_NAMES.items():
        structure = STRUCTURES[kind]
        lines.append(f'printf("%zu\\n", sizeof({name}));')
        expected.append(structure.itemsize)
        for member in members(kind):
            lines.append(f'printf("%zu\\n", offsetof({name}, {member.name}));')
            expected.append(structure.fields[member.name][1])
    source, program = tmp_path / "layout.c", tmp_path / "layout"
    source.write_text("\n".join([*lines, "return 0; }"]))
    subprocess.run(["cc", f"-I{LAWS}", "-o", program, source], check=True)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert list(map(int, printed.split())) == expected


def test_the_loop_of_the_page_brings_the_base_home_and_draws_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, Any] = {}
    exec(compile(EXAMPLES[0], "controller.md", "exec"), names)
    poses = np.array(names["poses"])
    assert np.hypot(*poses[0, :2]) > 0.1
    after = poses[names["times"] > 30.0]
    assert np.hypot(after[:, 0], after[:, 1]).max() < 0.02  # [m]; joint 1 swings meanwhile
    assert np.abs(after[:, 2]).max() < np.radians(3.0)
    assert np.ptp(after, axis=0).min() > 0.0
    assert (tmp_path / "hold.png").stat().st_size > 10_000


def test_the_law_of_the_page_is_one():
    names: dict[str, Any] = {}
    exec(compile(EXAMPLES[1], "controller.md", "exec"), names)
    outputs = names["MyLaw"](4, 0.02).step(inputs(4))
    outputs.require_finite()
    assert outputs.wrench.shape == (3,)
