"""Dependencies: package.xml has keys of rosdep, pip adds the rest, CONTRIBUTING.md lists both."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fss_arm_ros.libraries import LIBRARIES

ROOT = Path(__file__).resolve().parents[3]
MANIFESTS = sorted(ROOT.glob("src/*/package.xml"))
#: Keys that `rosdep resolve KEY --os ubuntu:noble --rosdistro jazzy` resolves to apt packages. Keys
#: of pip packages (python3-...-pip) are left out: rosdep installs such a package with --upgrade,
#: which replaces the numpy that ROS is built for.
REVIEWED = {
    *("action_msgs", "ament_cmake", "ament_index_python", "builtin_interfaces", "control_msgs"),
    *("diagnostic_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces", "rclpy"),
    *("rosgraph_msgs", "rosidl_default_generators", "rosidl_default_runtime", "sensor_msgs"),
    *("std_msgs", "std_srvs", "tf2_msgs", "trajectory_msgs", "unique_identifier_msgs"),
    "visualization_msgs",
    *("python3-matplotlib", "python3-numba", "python3-numpy", "python3-pytest", "python3-rich"),
    *("python3-scipy", "python3-serial", "python3-yaml"),
}


def section():
    """Return the section of CONTRIBUTING.md about libraries."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    return text.partition("\n## Libraries")[2].partition("\n## ")[0]


def keys(manifest):
    """The rosdep keys of a package.xml, without the packages of this workspace."""
    ours = {path.parent.name for path in MANIFESTS}
    tags = ElementTree.parse(manifest).getroot()
    return {tag.text for tag in tags if tag.tag.endswith("depend")} - ours


def test_every_key_is_reviewed():
    assert set().union(*map(keys, MANIFESTS)) == REVIEWED
    assert {library.rosdep for library in LIBRARIES.values()} - {""} < REVIEWED


@pytest.mark.parametrize("name", ["requirements.txt", "requirements-jazzy.txt"])
def test_every_library_is_pinned_for_pip(name):
    pinned = re.findall(r"^([\w-]+)==", (ROOT / "scripts" / name).read_text(), re.M)
    assert {library.pip for library in LIBRARIES.values()} <= set(pinned)


def test_the_table_of_libraries_is_that_of_the_code():
    rows = re.findall(r"^\| `([\w-]+)` \| (?:`([\w-]+)`|pip) \|", section(), re.M)
    expected = {(library.pip, library.rosdep) for library in LIBRARIES.values()}
    assert sorted(rows) == sorted(expected)


def test_pip_installs_what_rosdep_does_not():
    (names,) = re.findall(r"^pip install -c scripts/requirements-jazzy.txt (.*)$", section(), re.M)
    expected = {library.pip for library in LIBRARIES.values() if not library.rosdep}
    assert sorted(names.split()) == sorted(expected)
