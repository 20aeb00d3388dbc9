"""The shipped control laws: flown in the plant in stepped time, and equal in all their forms."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fss_gnc.law.forms import LawError, load

LAWS = Path(__file__).parents[3] / "docs/examples/laws"
sys.path.append(str(LAWS))

import fly  # noqa: E402 (a script of the examples)

PERIOD = 1.0 / fly.RATE


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """compiled("pd_hold.c"): the library, made by the command that the file's comment gives."""

    @cache
    def compile_law(name):
        library = tmp_path_factory.mktemp("law") / "libpd_hold.so"
        text = (LAWS / name).read_text()
        command = re.search(r"^\W*((?:cc|c\+\+) .*?)(?: \*/)?$", text, re.M)[1].split()
        command[command.index("-o") + 1] = str(library)
        warnings = ["-Wall", "-Wextra", "-Werror"]
        subprocess.run([command[0], *warnings, *command[1:]], cwd=LAWS, check=True)
        return library

    return compile_law


@cache
def flight(name):
    return list(fly.fly(load(f"{LAWS}/{name}", 4, PERIOD), 40.0))


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


@pytest.mark.parametrize("name", ["pd_hold.c", "pd_hold.cpp"])
def test_the_law_in_c_gives_the_commands_of_the_law_in_python(name, compiled):
    law = load(str(compiled(name)), 4, PERIOD)
    for step in flight("pd_hold.py:PdHold"):
        got, expected = law.step(step.inputs), step.outputs
        np.testing.assert_allclose(got.wrench, expected.wrench, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(
            got.joint_velocities, expected.joint_velocities, rtol=0.0, atol=1e-12
        )
        assert got.valve_on_times is None
        assert got.gripper_closed is None
    law.terminate()


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        ("", "law is '', expected MODULE:CLASS, FILE.py:CLASS or LIBRARY.so"),
        ("pd_hold.py", "expected MODULE:CLASS"),
        ("nowhere.py:PdHold", "no file nowhere.py in /"),
        ("nowhere:PdHold", "no module nowhere"),
        (f"{LAWS}/pd_hold.py:Pd", "has no class Pd; it has PdHold"),
        ("fss_gnc.law.forms:load", "has no method step"),
        ("nowhere.so", "no file nowhere.so in /"),
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
