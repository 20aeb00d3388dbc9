"""The example that judges a law: its table, and its answer if there are no states."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from gnc_bench import FakeCraft

from fss_arm_msgs.msg import SimTruth
from fss_arm_ros.qos import SENSOR

EXAMPLE = Path(__file__).parents[3] / "docs/examples/judge_law.py"
SIMULATED = 5_000_000_000  # a time that no computer has [ns]
IN_SIMULATED_TIME = "--ros-args", "-p", "use_sim_time:=true"


@pytest.fixture
def judge(spin, domain, tmp_path):
    def run(craft, *words):
        program = subprocess.Popen(
            [sys.executable, EXAMPLE, "--output", tmp_path / "error.png", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        )
        try:
            spin(craft, lambda: program.poll() is not None, timeout=120.0)
        finally:
            program.kill()
        return program.returncode, *program.communicate()

    return run


@pytest.mark.parametrize(
    ("time", "silent", "options", "words"),
    [
        (None, {"base/state"}, (), "no base/state in ROS domain"),
        (SIMULATED, set(), (), "simulated clock: add --ros-args -p use_sim_time:=true"),
        (None, set(), IN_SIMULATED_TIME, "computer's clock: leave out use_sim_time"),
    ],
)
def test_without_states_of_its_clock_it_names_the_remedy(time, silent, options, words, judge):
    craft = FakeCraft(time)
    craft.silent |= silent
    code, out, err = judge(craft, "--wait", "5", *options)
    assert (code, out) == (1, "")
    assert words in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(("time", "options"), [(None, ()), (SIMULATED, IN_SIMULATED_TIME)])
def test_it_prints_errors_and_propellant(time, options, judge, tmp_path):
    craft = FakeCraft(time)
    craft.pose[:] = 0.03, -0.04, -0.1
    truth, used = craft.create_publisher(SimTruth, "sim/truth", SENSOR), iter(range(10**9))
    craft.create_timer(0.02, lambda: truth.publish(SimTruth(propellant=1e-6 * next(used))))
    code, out, _ = judge(craft, "--duration", "2", "--wait", "60", *options)
    title, *rows = out.splitlines()
    assert title == "time [s]  position error [mm]  heading error [deg]  propellant [g]"
    first, last = ([float(value) for value in row.split() if value != "unknown"] for row in rows)
    assert first[:3] == [0.0, 50.0, -5.73]  # the propellant may not be known yet
    assert last[1:3] == [50.0, -5.73]
    assert 2.0 <= last[0] < 10.0
    assert 0.01 < last[3] < 1.0
    assert code == 0
    assert (tmp_path / "error.png").exists()
