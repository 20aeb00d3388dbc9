"""The page that takes a bag to arrays: its code runs, and says what the bag holds."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

ROOT = Path(__file__).resolve().parents[3]
CODE = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/how-to/data.md").read_text(), re.M | re.S)


@pytest.fixture(autouse=True)
def root(monkeypatch):
    monkeypatch.chdir(ROOT)


def run(code):
    names = {}
    exec(compile(code, "data.md", "exec"), names)
    return names


def test_a_bag_is_an_array_in_five_lines():
    assert len(list(filter(None, CODE[0].splitlines()))) == 6  # and one that prints
    base = run(CODE[0])["base"]
    assert base.shape == (490, 3)
    assert 0.01 < np.ptp(base[:, 1]) < 1.0
    assert (np.diff(base[:, 0]) > 0.0).all()  # full time stamps, not whole seconds


def test_joints_are_brought_to_one_time():
    names = run(CODE[1])
    assert names["q"].shape == (len(names["times"]), 4)
    assert np.abs(np.diff(names["times"]) - 0.05).max() < 1e-6
    assert 0.5 < np.abs(names["q"]).max() < 1.6


def test_matlab_gets_all_numbers_of_a_bag(tmp_path, capsys):
    example = runpy.run_path(str(ROOT / "docs/examples/bag_to_mat.py"))
    example["main"]("test/data/first", str(tmp_path / "out/first.mat"))
    assert "joint_states: 986 messages, t, " in capsys.readouterr().out
    found = loadmat(tmp_path / "out/first.mat", simplify_cells=True)
    np.testing.assert_allclose(
        found["vicon_fss_fss"]["pose_position_x"], run(CODE[0])["base"][:, 1]
    )
    joints = found["joint_states"]
    assert set(joints["name"]) == {"joint_1", "joint_2", "joint_3", "joint_4"}
    assert joints["position"][joints["name"] == "joint_1"].dtype.kind == "f"
    assert found["link_1_telemetry"]["battery"].shape == (12,)
    assert not any(
        "msgtype" in name for table in found.values() if isinstance(table, dict) for name in table
    )
