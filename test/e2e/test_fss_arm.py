"""The person's commands, against the real driver and simulator."""

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import DOMAIN
from driver_link import RATE, FakeTransport
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.protocol import Order
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
    for what, said in (
        ("arm", "nobody offers arm/arm\n"),
        ("home", "nobody drives a link\n"),
        ("solve", "no calibration runs\n"),
    ):
        told = tell(what, "--wait", "1")
        assert (told.returncode, told.stderr) == (1, said)


@pytest.fixture
def telling(spin):
    """telling(nodes, command, **env): what came of a command while these nodes were run."""
    running = []

    def run(nodes, command, **env):
        process = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, **env},
        )  # fmt: skip
        running.append(process)
        spin(nodes, lambda: process.poll() is not None, 30.0)
        return (process.returncode, *process.communicate())

    yield run
    for process in running:
        process.kill()
        process.wait()


@pytest.fixture
def bench(spin):
    """Two links that have lost their reference, behind their drivers."""
    transports = [FakeTransport(i) for i in (1, 2)]
    parameters = [Parameter("rate", value=RATE), Parameter("timeout", value=5.0)]
    nodes = []
    for i, transport in enumerate(transports, 1):
        transport.link.referenced = False
        nodes.append(LinkNode(i, transport=transport, parameter_overrides=parameters))
    spin(nodes, lambda: not any(node.session.lost for node in nodes))
    return nodes, transports


def arm(spin, nodes, node):
    with node.lock:
        node.session.arm(node.now())
    spin(nodes, lambda: node.session.armed)


def test_links_that_are_armed_are_homed(spin, bench, telling):
    nodes, transports = bench
    home = sys.executable, SCRIPT, "home", "--within", "2"
    unarmed = "link {} is not referenced: it is not armed"
    assert telling(nodes, home) == (1, "", f"{unarmed.format(1)}; {unarmed.format(2)}\n")

    looks = "link {} looks for its reference\n"
    arm(spin, nodes, nodes[0])
    assert telling(nodes, home) == (1, looks.format(1), unarmed.format(2) + "\n")
    assert [transport.link.referenced for transport in transports] == [True, False]

    arm(spin, nodes, nodes[1])
    transports[1].hears = False
    said = "link 2 is not referenced after 2 s\n"
    assert telling(nodes, home) == (1, looks.format(2), said)
    transports[1].hears = True  # the last HOME may still be in force
    code, out, err = telling(nodes, home)
    assert (code, err) == (0, "")
    assert out.endswith("all 2 links are referenced\n")


def test_homing_that_is_interrupted_says_so(spin, bench):
    nodes, transports = bench
    arm(spin, nodes, nodes[0])
    transports[0].link.take = lambda *_: None  # it never finds its reference
    with subprocess.Popen(
        [sys.executable, SCRIPT, "home"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        spin(nodes, lambda: nodes[0].session.progress is not None, 20.0)
        process.send_signal(signal.SIGINT)
        spin(nodes, lambda: process.poll() is not None)
        assert process.returncode == 1
        assert process.communicate() == ("link 1 looks for its reference\n", "interrupted\n")


def test_faults_of_all_links_are_cleared(spin, bench, telling):
    nodes, transports = bench
    arm(spin, nodes, nodes[0])
    said = "".join(f"link_{i}/clear_faults: asked for\n" for i in (1, 2))
    assert telling(nodes, (sys.executable, SCRIPT, "clear")) == (0, said, "")
    assert not nodes[0].session.armed
    for transport in transports:
        assert transport.link.taken.flags & Order.CLEAR_FAULTS


def test_all_calibrations_that_run_solve_in_the_domain_of_the_configuration(ros, telling, tmp_path):
    node, answers = Node("calibrations"), {"kinematic": "pass: fits", "drift": "fail: a push"}

    def answer(words):
        def solve(_, response):
            response.success, response.message = words.startswith("pass"), words
            return response

        return solve

    for kind, words in answers.items():
        node.create_service(Trigger, f"{kind}/solve", answer(words))
    config = tmp_path / "lab.sh"
    config.write_text(
        f"export ROS_DOMAIN_ID={DOMAIN}\nFSS_LOGS={tmp_path / 'logs'}\n"
        "node kinematic fss_arm_calib kinematic\n"
    )
    code, out, err = telling(node, (SCRIPT.with_suffix(".sh"), "solve", config), ROS_DOMAIN_ID="0")
    assert (code, out) == (1, "")
    assert err == "kinematic/solve: pass: fits\ndrift/solve: fail: a push\n"
    node.create_service(Trigger, "kinematic/forget", answer("pass: 13 observations forgotten"))
    told = telling(node, (sys.executable, SCRIPT, "forget"))
    assert told == (0, "kinematic/forget: pass: 13 observations forgotten\n", "")
