"""A control law in C flown by the node `controller` on the simulated test bed, and killed."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from flight import Flyer, start
from running import OWN

from fss_arm_ros.convert import stamp_ns
from fss_rehearsal.processes import Nodes

pytestmark = pytest.mark.slow
SPEED = 0.5  # of the time, that a busy computer keeps up with it
LAWS = Path(__file__).parents[3] / "docs/examples/laws"
LIMIT = 0.8  # from the end of a law to closed valves: time to live and the computer [s]


@pytest.fixture
def flyer(tmp_path):
    library = tmp_path / "libpd_hold.so"
    command = ["cc", "-O2", "-fPIC", "-shared", "-o", library, LAWS / "pd_hold.c", "-lm"]
    subprocess.run(command, check=True)
    rclpy.init(args=[])
    with Nodes(tmp_path, print, OWN) as nodes:
        start(nodes, speed=SPEED, gnc=["navigation"])
        nodes.run(
            "controller",
            [sys.executable, "-m", "fss_gnc.controller_node"],
            use_sim_time=True,
            law=library,
            rate=20.0,
        )
        flyer = Flyer(nodes)
        flyer.clients_to.clear()  # actions of guidance
        yield flyer
        flyer.close()
    rclpy.try_shutdown()


def test_a_law_holds_the_base_until_it_is_killed(flyer):
    found = []
    flyer.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda m: found.extend(s for s in m.status if s.name == "/controller"),
        10,
    )
    flyer.begin()
    flyer.pass_time(20.0)
    flyer.until(lambda: found, why="diagnostics of the controller")
    start_time, q = flyer.t, np.array(flyer.truths[-1].q)
    flyer.pass_time(10.0)
    offset, turned = flyer.off(q[:3], start_time)
    print(f"{1e3 * offset:.2f} mm, {turned:.3f} deg, {flyer.truths[-1].propellant:.4f} kg")
    assert offset < 0.02
    assert turned < 2.0
    values = {v.key: v.value for v in found[-1].values}
    print(found[-1].message, values)
    assert found[-1].level < found[-1].ERROR
    assert float(values["latency p50 [ms]"]) < 200.0
    os.kill(int(values["process"]), signal.SIGKILL)
    killed = flyer.t
    flyer.until(lambda: re.search("SIGKILL", found[-1].message), why=found[-1].message)
    flyer.pass_time(2.0)
    open_at = [
        1e-9 * stamp_ns(t.header.stamp)
        for t in flyer.truths
        if any(t.valves) and 1e-9 * stamp_ns(t.header.stamp) > killed
    ]
    assert max(open_at, default=killed) - killed < LIMIT
    assert np.abs(np.array(flyer.truths[-1].q[3:]) - q[3:]).max() < 0.01
