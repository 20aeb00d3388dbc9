"""The real ros2 command line, where it has been added: each command of its page, on a graph."""

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from driver_link import RATE, FakeTransport
from rclpy.parameter import Parameter

from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.link_node import LinkNode

PAGE = Path(__file__).resolve().parents[3] / "docs/how-to/ros2cli.md"
ROS2 = shutil.which("ros2", path=os.environ.get("PATH", "").replace("scripts/bin", "nowhere"))
COMMANDS = re.findall(r"^ros2 .*", PAGE.read_text().partition("## Useful commands")[2], re.M)
SAID = {
    "ros2 node list": "/link_4",
    "ros2 topic list -t": "/arm/joint_states [sensor_msgs/msg/JointState]",
    "ros2 topic info -v /link_1/telemetry": "Publisher count: 1",
    "ros2 topic echo --once /arm/joint_states": "- joint_4",
    "ros2 topic echo --once --field data /robot_description": "<robot name=",
    "ros2 interface show fss_arm_msgs/msg/LinkTelemetry": "raw as on the wire",
    "ros2 param list /arm": "margin",
    "ros2 param describe /link_1 timeout": "Min value: ",
    "ros2 param get /arm margin": "Double value is: 0.0",
    "ros2 pkg executables fss_arm_driver": "fss_arm_driver link",
    "ros2 service call /arm/enable": "success=True, message='all 4 links are armed'",
    "ros2 action send_goal --feedback /arm/move": "Goal finished with status: SUCCEEDED",
    "ros2 topic pub --once /arm/stop": "publishing #1",
}


@pytest.mark.skipif(ROS2 is None, reason="needs the real ros2: docs/how-to/ros2cli.md adds it")
def test_each_command_of_the_page_says_what_it_should(spin):
    given = [Parameter("rate", value=RATE), Parameter("timeout", value=5.0)]
    links = [
        LinkNode(i, transport=FakeTransport(i), parameter_overrides=given) for i in range(1, 5)
    ]
    whole = ArmNode(parameter_overrides=[*given[:1], Parameter("time_to_live", value=2.5)])
    nodes = [*links, whole]
    spin(nodes, lambda: len(whole.links.states) == 4)
    asked = [line for line in COMMANDS if not line.startswith("ros2 bag")]
    assert len(asked) == len(SAID)
    try:
        for line in asked:
            words = [ROS2, *shlex.split(line)[1:]]
            with subprocess.Popen(
                words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            ) as process:
                spin(nodes, lambda process=process: process.poll() is not None, 60.0)
                said = process.communicate()[0]
            (expected,) = (words for start, words in SAID.items() if line.startswith(start))
            assert process.returncode == 0, said
            assert expected in said, line
    finally:
        subprocess.run([ROS2, "daemon", "stop"], capture_output=True, timeout=60, check=False)
