"""The person's commands, against the real driver and simulator."""

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from rclpy.node import Node

from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR

SCRIPT = Path(__file__).resolve().parents[2] / "scripts/fss_arm.py"


def tell(what, *options):
    return subprocess.run(
        [sys.executable, SCRIPT, what, *options],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_links_arm_stop_and_disarm_as_told(start, spin, tmp_path):
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
    for s in sockets:
        s.bind(("127.0.0.1", 0))
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    start("fss_sim.testbed_node", "--ros-args", "-p", f"ports:={ports}")
    urls = [f"udp://127.0.0.1:{port}?bind=0" for port in ports]
    start("fss_arm_driver.link_node", "--ros-args", "-p", f"urls:={urls}")
    start("fss_arm_driver.arm_node")

    node, armed = Node("watch"), {}
    for i in range(1, 5):
        node.create_subscription(
            LinkTelemetry, f"link_{i}/telemetry", lambda m: armed.update({m.link: m.armed}), SENSOR
        )
    spin(node, lambda: len(armed) == 4, 30.0)
    assert not any(armed.values())

    said = []
    # A link that a busy machine kept waiting for too long is disarmed, and wants to be told again.
    spin(node, lambda: all(armed.values()) or said.append(tell("arm").stdout), 60.0)
    assert said[-1] == "all 4 links are armed\n"
    told = tell("stop")
    assert told.returncode == 0, told.stderr
    assert re.fullmatch(r"stop sent to \d listeners\n", told.stdout)
    spin(node, lambda: not any(armed.values()))
    assert tell("disarm").returncode == 0


def test_nobody_there_is_said_in_one_line(domain):
    told = tell("solve", "--wait", "1")
    assert told.returncode == 1
    assert told.stderr == "nobody offers kinematic/solve\n"
