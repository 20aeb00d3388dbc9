"""The example that moves a vehicle: its command line, and the phases of its own goal."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from rclpy.action import ActionServer
from rclpy.node import Node

from fss_arm_msgs.action import GoToPose
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.qos import LATCHED

EXAMPLE = Path(__file__).parents[3] / "docs/examples/go_to.py"


def start(domain, *words):
    return subprocess.Popen(
        [sys.executable, EXAMPLE, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
    )


@pytest.mark.parametrize(
    ("words", "code", "line"),
    [
        (["--help"], 0, "its namespace, such as fss1"),
        (["0.1", "0.05", "0.2"], 2, "go_to.py: error: the following arguments are required"),
        (["fss1", "0.1", "0.05", "x"], 2, "argument HEADING: invalid float value: 'x'"),
        (["0.1", "0.1", "0.05", "0.2"], 2, "VEHICLE is '0.1', expected a namespace such as fss1"),
    ],
)
def test_a_wrong_command_line_is_answered_in_one_line(words, code, line, domain):
    program = start(domain, *words)
    out, err = program.communicate(timeout=120.0)
    assert line in out + err
    assert "Traceback" not in err
    assert program.returncode == code


def test_it_prints_the_phases_of_its_own_goal(spin, domain):
    guidance, goals = Node("guidance", namespace="fss1"), []
    states = guidance.create_publisher(MissionState, "mission/state", LATCHED)

    def publish(**fields):
        state = MissionState(mission="go_to", **fields)
        state.header.stamp = guidance.get_clock().now().to_msg()
        states.publish(state)

    def fly(handle):
        goals.append(list(handle.request.pose))
        handle.succeed()
        return GoToPose.Result(reached=True)

    publish(phase="brake", reason="of a former goal", elapsed=31.4)
    ActionServer(guidance, GoToPose, "base/go_to", fly)
    program = start(domain, "fss1", "-0.1", "0.0", "1.57")
    try:
        spin(guidance, lambda: program.poll() is not None, timeout=120.0)
    finally:
        program.kill()
    assert program.communicate() == ("fss1 reached: True \n", "")
    assert (goals, program.returncode) == ([[-0.1, 0.0, 1.57]], 0)
