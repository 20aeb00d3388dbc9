"""The shipped control laws: flown in the plant in stepped time, and equal in all their forms."""

import re
import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import fmu
import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_gnc.law import Outputs
from fss_gnc.law.contract import LawError
from fss_gnc.law.forms import load

LAWS = Path(__file__).parents[3] / "docs/examples/laws"
sys.path.append(str(LAWS))

import fly  # noqa: E402 (a script of the examples)
import nmpc  # noqa: E402

PERIOD = 1.0 / fly.RATE


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """compiled("pd_hold.c"): the library, made by the command that the file's comment gives.

    compiled("pd_hold.c", 2): the FMU of FMI 2.0, as scripts/fmu.sh exports it.
    """

    @cache
    def compile_law(name, fmi=None):
        if fmi:
            output = tmp_path_factory.mktemp("law") / "pd_hold.fmu"
            fmu.export(fmu.law_model(LAWS / name), fmi, output)
            return output
        library = tmp_path_factory.mktemp("law") / "libpd_hold.so"
        text = (LAWS / name).read_text()
        command = re.search(r"^\W*((?:cc|c\+\+) .*?)(?: \*/)?$", text, re.M)[1].split()
        command[command.index("-o") + 1] = str(library)
        warnings = ["-Wall", "-Wextra", "-Werror"]
        subprocess.run([command[0], *warnings, *command[1:]], cwd=LAWS, check=True)
        return library

    return compile_law


@pytest.mark.parametrize("name", ["pd_hold.py", "pd_hold.cpp"])
def test_only_a_law_in_c_is_exported(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["fmu.sh", name])
    assert fmu.main() == 1
    words = "only a law in C (.c) or a description (.yaml) can be exported"
    assert capsys.readouterr().err == f"fmu.sh: {name}: {words}\n"


@cache
def flight(name):
    return list(fly.fly(load(f"{LAWS}/{name}", 4, PERIOD), paper_arm(), 40.0))


@pytest.mark.parametrize(("name", "most"), [("pd_hold.py:PdHold", 0.003), ("lqr.py:Lqr", 0.001)])
def test_a_law_takes_the_base_to_its_reference_and_holds_it(name, most):
    steps = flight(name)
    errors = np.array([step.error for step in steps])
    assert np.hypot(*errors[0, :2]) > 0.1
    late = errors[int(35.0 * fly.RATE) :]
    assert np.hypot(*late[:, :2].T).max() < most
    assert np.abs(late[:, 2]).max() < np.radians(0.2)
    q = np.array([step.inputs.joint_angles for step in steps])
    assert np.abs(q - q[0]).max() < 1e-3
    assert steps[-1].propellant < 0.01


def test_commands_of_another_size_are_refused_as_on_the_test_bed():
    class Wrong:
        def step(self, inputs):
            return Outputs(joint_velocities=np.zeros(3))

    with pytest.raises(LawError, match=r"joint_velocities has shape \(3,\), expected \(4,\)"):
        next(fly.fly(Wrong(), paper_arm(), 1.0))


@pytest.mark.parametrize(
    "form", [("pd_hold.c",), ("pd_hold.cpp",), ("pd_hold.c", 2), ("pd_hold.c", 3)], ids=str
)
def test_the_law_in_each_form_gives_the_commands_of_the_law_in_python(form, compiled):
    law = load(str(compiled(*form)), 4, PERIOD)
    for step in flight("pd_hold.py:PdHold"):
        got, expected = law.step(step.inputs), step.outputs
        np.testing.assert_allclose(got.wrench, expected.wrench, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(
            got.joint_velocities, expected.joint_velocities, rtol=0.0, atol=1e-12
        )
        assert got.valve_on_times is None
        assert got.gripper_closed is None
    law.terminate()


def test_the_nmpc_law_predicts_the_momentum_reaches_and_holds(tmp_path):
    q = fly.start(paper_arm())
    momentum = np.array(nmpc.momentum_matrix(paper_arm())(q[:3], q[3:]))
    expected = inertia_matrix(paper_arm().vector(), q)[:3]
    np.testing.assert_allclose(momentum, expected, rtol=0.0, atol=1e-12)
    subprocess.run([sys.executable, LAWS / "nmpc.py"], cwd=tmp_path, check=True)
    library = tmp_path / "libnmpc.so"
    command = ["cc", "-O1", "-ffp-contract=off", "-fPIC", "-shared", "-o", library]
    sources = [LAWS / "nmpc.c", tmp_path / "nmpc_solver.c"]
    subprocess.run([*command, *sources, "-lm"], check=True)
    steps = list(fly.fly(load(str(library), 4, PERIOD), paper_arm(), 40.0))
    errors = np.array([step.error for step in steps])
    late = errors[int(35.0 * fly.RATE) :]
    assert np.hypot(*late[:, :2].T).max() < 0.002
    assert np.abs(late[:, 2]).max() < np.radians(0.2)
    np.testing.assert_allclose(steps[-1].inputs.joint_angles, [-0.6, 0.6, 0.6, -0.6], atol=2e-3)
    assert steps[-1].propellant < 0.05


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        ("", "law is '', expected MODULE:CLASS, FILE.py:CLASS, LIBRARY.so or FILE.fmu"),
        ("pd_hold.py", "expected MODULE:CLASS"),
        ("nowhere.py:PdHold", "no file nowhere.py in /"),
        ("nowhere:PdHold", "no module nowhere"),
        (f"{LAWS}/pd_hold.py:Pd", "has no class Pd; it has PdHold"),
        ("fss_gnc.law.forms:load", "has no method step"),
        ("nowhere.so", "no file nowhere.so in /"),
        ("nowhere.fmu", "no file nowhere.fmu in /"),
    ],
)
def test_a_law_that_cannot_be_loaded_has_its_reason(law, reason):
    with pytest.raises((LawError, TypeError)) as error:
        load(law, 4, PERIOD)
    assert reason in str(error.value) or isinstance(error.value, TypeError)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("int other(void) { return 0; }", r"law.so is not a law: .*law_contract"),
        ((LAWS / "pd_hold.c").read_text(), r"another version of law.h"),
    ],
    ids=["no law", "another header"],
)
def test_a_library_of_another_contract_is_refused(tmp_path, source, words):
    text = (LAWS / "law.h").read_text()
    (tmp_path / "law.h").write_text(re.sub(r"return 0x\w+", "return 1", text))
    (tmp_path / "law.c").write_text(source)
    command = ["cc", "-shared", "-fPIC", "-o", tmp_path / "law.so", tmp_path / "law.c", "-lm"]
    subprocess.run(command, check=True)
    with pytest.raises(LawError, match=words):
        load(f"{tmp_path}/law.so", 4, PERIOD)


def with_description(made, tmp_path, changes):
    """Return an FMU with texts of its modelDescription.xml replaced."""
    changed = tmp_path / "law.fmu"
    with zipfile.ZipFile(made) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            content = old.read(name).decode("latin-1")
            for text, other in changes.items() if name == "modelDescription.xml" else ():
                assert text in content
                content = content.replace(text, other)
            new.writestr(name, content.encode("latin-1"))
    return changed


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {'"base_pose': '"base_pos', '"joint_velocities': '"joint_velocity'},
            r"input base_pos\S* is unknown, the nearest is base_pose\S*; "
            r"output joint_velocity\S* is unknown, the nearest is joint_velocities",
        ),
        ({'"base_age': '"base_twist[4]'}, r"input base_twist\[4\] is unknown"),
        ({'"target_pose_valid"': '"local"', '"input"': '"output"'}, "output joints is unknown"),
        ({"CoSimulation": "ModelExchange"}, "has no co-simulation"),
        ({"</fmiModelDescription>": ""}, "is not an FMU: "),
    ],
    ids=["two names", "index", "causality", "model exchange", "broken"],
)
def test_an_fmu_that_does_not_fit_is_refused_with_the_reason(
    fmi, changes, words, compiled, tmp_path
):
    changed = with_description(compiled("pd_hold.c", fmi), tmp_path, changes)
    with pytest.raises(LawError, match=words):
        load(str(changed), 4, PERIOD)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("target_pose_valid", "^.* does not fit the contract: input target_pose_valid is missing$"),
        ("wrench[2]", r"output wrench\[2\] is missing$"),
        ("joint_angles[4]", r"input joint_angles\[4\] is missing$"),
        ("joint_angles[5]", None),  # of an arm with more links
        ("wrench_valid", None),  # then the wrench is always given
    ],
)
def test_an_incomplete_fmu_is_refused_with_what_it_lacks(name, words, compiled, tmp_path):
    made = compiled("pd_hold.c", 2)
    xml = zipfile.ZipFile(made).read("modelDescription.xml").decode()
    line = re.search(rf'<ScalarVariable name="{re.escape(name)}".*causality="\w+"', xml)[0]
    local = re.sub(r'causality="\w+"', 'causality="local"', line)
    changed = str(with_description(made, tmp_path, {line: local}))
    if words:
        with pytest.raises(LawError, match=words):
            load(changed, 4, PERIOD)
    else:
        step, law = flight("pd_hold.py:PdHold")[0], load(changed, 4, PERIOD)
        np.testing.assert_array_equal(law.step(step.inputs).wrench, step.outputs.wrench)
        law.terminate()
