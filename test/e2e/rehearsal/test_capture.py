"""The rehearsal of a capture as a person runs it."""

import subprocess
import sys

import numpy as np
import pytest

from fss_arm_bags.reader import open_bags


@pytest.mark.slow
def test_a_capture_is_rehearsed_recorded_and_drawn(tmp_path):
    out = tmp_path / "mission"
    command = [sys.executable, "-m", "fss_rehearsal", "capture", "--out", out]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for phase in ("approach", "reach", "detumble", "done"):
        assert phase in done.stdout
    assert (out / "report" / "mission.png").stat().st_size > 10_000
    with open_bags(out / "bag") as bags:
        truths = [m for _, _, _, m in bags.messages({"/sim/truth"})]
    k = next(i for i, m in enumerate(truths) if m.holds)
    change = truths[k].momentum - truths[k - 1].momentum
    given = truths[k].impulse - truths[k - 1].impulse
    np.testing.assert_allclose(change, given, rtol=0, atol=1e-9)
    assert abs(truths[k - 1].target_twist[2]) > 0.1
    assert abs(truths[-1].target_twist[2]) < 0.01
