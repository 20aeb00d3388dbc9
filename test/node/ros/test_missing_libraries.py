"""Executables without a library that they need: one line and exit code 1."""

import os
import sys

import pytest
from running import run_command

from fss_arm_ros.libraries import LIBRARIES

#: Read by Python as it starts: hides modules, as if they were not installed.
SITE = """
import os, sys
from importlib.machinery import PathFinder

class Hiding(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        hidden = name in os.environ["HIDDEN_MODULES"].split()
        return None if hidden else super().find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Hiding
"""
RUN = """
import sys
from importlib.metadata import distribution
package, name, *arguments = sys.argv[1:]
sys.argv = [f"lib/{package}/{name}", *arguments]
sys.exit(distribution(package).entry_points[name].load()())
"""


@pytest.fixture
def python(tmp_path, domain):
    """python(hidden, code, *arguments): run code without the modules named in `hidden`."""
    (tmp_path / "sitecustomize.py").write_text(SITE)

    def run(hidden, code, *arguments):
        env = os.environ | {
            "HIDDEN_MODULES": hidden,
            "PYTHONPATH": f"{tmp_path}:{os.environ['PYTHONPATH']}",
            "ROS_DOMAIN_ID": str(domain),
        }
        return run_command(sys.executable, "-c", code, *arguments, env=env, cwd=tmp_path)

    return run


@pytest.mark.parametrize(
    ("hidden", "package", "command"),
    [
        ("rerun", "fss_arm_view", "view"),
        ("rosbags", "fss_arm_bags", "record"),
        ("backports", "fss_arm_bags", "replay bag"),
        ("mcap", "fss_arm_bags", "doctor bag"),
        ("matplotlib", "fss_arm_calib", "from_bag bag --report report"),
        ("matplotlib", "fss_arm_calib", "kinematic --ros-args -p report:=report"),
        ("rich", "fss_arm_calib", "links arm.yaml"),
        ("matplotlib", "fss_arm_motion", "plan point_to_point --goal 9 0 0 0 --figure plan.png"),
        ("matplotlib", "fss_arm_workspace", "map"),
        ("motioncapture", "fss_base_driver", "mocap --ros-args -p system:=mock"),
        ("fmpy", "fss_gnc", "controller --ros-args -p law:=law.fmu"),
        ("serial", "fss_arm_driver", "link --ros-args -p url:=serial://ttyNONE"),
        ("serial", "fss_base_driver", "fog --ros-args -p device:=/dev/ttyNONE"),
        ("numba", "fss_arm_driver", "arm"),
    ],
)
def test_an_executable_without_its_library_exits_with_one_line(python, hidden, package, command):
    name, *arguments = command.split()
    ended = python(hidden, RUN, package, name, *arguments)
    last = [line for line in ended.stderr.splitlines() if "[INFO]" not in line]
    assert len(last) == 1, ended.stderr
    assert last[0].startswith(f"{name}: {LIBRARIES[hidden].pip} is missing; install it with: ")
    assert ended.returncode == 1


@pytest.mark.parametrize("url", ["udp://127.0.0.1:9?bind=0", "tcp://127.0.0.1:9"])
def test_network_links_need_no_serial_library(python, url):
    code = "import sys; from fss_arm_driver.transport import *; open_transport(sys.argv[1]).close()"
    ended = python("serial", code, url)
    assert (ended.returncode, ended.stderr) == (0, "")
