"""Interfaces that the set-up builds where the wheels lack them: as the distribution has them."""

import json
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory

#: Of the packages that ROS 2 Jazzy has: programs with others do not hear each other.
HASHES = {
    "control_msgs/action/FollowJointTrajectory": "738ebcb7a2d7cfa42f9f1001cc99ce3a"
    "4383d1cfe508015d9be8485e4b1c66f6",
    "control_msgs/msg/JointTolerance": "c254f9cece0f3b733017b6990fd46d13"
    "26e25242d6b8844398c97d9a88e7d648",
}


@pytest.mark.parametrize("name", HASHES)
def test_programs_of_a_distribution_understand_them(name):
    package, kind, interface = name.split("/")
    file = Path(get_package_share_directory(package), kind, f"{interface}.json")
    told = {h["type_name"]: h["hash_string"] for h in json.loads(file.read_text())["type_hashes"]}
    assert told[name] == f"RIHS01_{HASHES[name]}"
