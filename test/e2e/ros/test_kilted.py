"""Every node on the rclpy of ROS 2 Kilted, in a copy of the workspace with its own .venv."""

import os
import shutil
from pathlib import Path

import pytest
from firmware import ROOT
from running import run_command

PINS = ROOT / "test/data/requirements-kilted.txt"
SETUP_TIMEOUT = 1500.0  # installs all packages, builds, and compiles the kernels [s]
LADDER = "test/e2e/ros/test_rclpy_versions.py"


def python_3_12():
    """Return a Python 3.12 of this machine, or None."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    candidates = [shutil.which("python3.12"), *versions.glob("3.12.*/bin/python3.12")]
    for candidate in filter(None, candidates):
        # A version manager's stand-in fails unless its version is selected.
        if not run_command(candidate, "-c", "import venv").returncode:
            return candidate
    return None


def copy_for_kilted(folder):
    """Copy the files under version control, with Kilted's packages and Fast DDS 3's spelling."""
    listed = run_command("git", "ls-files", cwd=ROOT, check=True)
    for name in listed.stdout.splitlines():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name, follow_symlinks=False)
    pins = folder / "scripts/requirements.txt"
    others = [line for line in pins.read_text().splitlines() if not line.startswith("ros-")]
    pins.write_text("\n".join([*others, PINS.read_text()]))
    profile = folder / "config/fastdds.xml"
    profile.write_text(profile.read_text().replace("heartbeatPeriod", "heartbeat_period"))


@pytest.mark.slow
def test_each_node_runs_on_the_rclpy_of_kilted(tmp_path):
    python = python_3_12()
    if python is None:
        pytest.skip("there is no Python 3.12")
    copy = tmp_path / "workspace"
    copy_for_kilted(copy)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python3").symlink_to(python)
    # Of this workspace's environment only what reaches the package index is passed on.
    passed = {k: v for k, v in os.environ.items() if k.lower().startswith(("pip_", "ssl_", "http"))}
    passed |= {"HOME": str(Path.home()), "PATH": f"{tmp_path / 'bin'}:/usr/local/bin:/usr/bin:/bin"}

    def run(command, timeout):
        done = run_command("bash", "-c", command, timeout=timeout, cwd=copy, env=passed)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    run("scripts/setup.sh --dev", SETUP_TIMEOUT)
    version = "import importlib.metadata as m; print(m.version('ros-rclpy'))"
    enter = ". scripts/env.sh && "
    assert run(f'{enter} python -c "{version}"', 60.0).startswith("9.1.")
    assert "1 passed" in run(f"{enter} python -m pytest -q {LADDER}", 400.0)
