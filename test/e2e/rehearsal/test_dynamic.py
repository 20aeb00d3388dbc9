"""A dynamic calibration as a person rehearses it: design, simulator over UDP, bags, solution."""

import subprocess
import sys

import numpy as np
import pytest

from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.recompute import main as recompute
from fss_arm_model.description_file import load
from fss_arm_model.parameters import parameter_names, values


@pytest.mark.slow
def test_the_truth_lies_within_what_is_claimed(tmp_path):
    """Eight maneuvers in two sessions, at real time: about two minutes."""
    out = tmp_path / "run"
    command = [sys.executable, "-m", "fss_rehearsal", "dynamic", "--count", "8", "--out", out]
    run = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert run.returncode in (0, 2), run.stdout + run.stderr  # 2: eight may be too few for I_1
    assert "sigma planned" in run.stdout
    assert (out / "report" / "index.html").exists()
    # What was said live follows from the maneuvers that were published with it.
    assert recompute([str(out / "bags")]) == 0
    # As eight are too few for every center of mass, what CAD tells of them is taken as a prior.
    settings = DynamicSettings(arm=str(out / "guess.yaml"), priors="b_i I_i I_0 com_0")
    result = solve_bag(DYNAMIC, out / "bags", settings)
    assert len(result.used) >= 6
    assert result.verdict == "pass", result.reason
    chosen = [name for name in result.names if not name.startswith("g_")]
    every = dict(zip(parameter_names(4), values(load(out / "truth.yaml")), strict=True))
    truth = np.array([every[name] for name in chosen])
    error = result.values[: len(chosen)] - truth
    nees = error @ np.linalg.solve(result.covariance[: len(chosen), : len(chosen)], error)
    assert nees < 32.9  # chi-square of 11, 0.05% beyond
