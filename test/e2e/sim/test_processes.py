"""The supervisor of a rehearsal's processes, on real ones."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from threading import Event
from time import monotonic

import pytest
from rclpy.node import Node
from running import DOMAIN, OWN, wait_until
from std_srvs.srv import SetBool

from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR
from fss_rehearsal.processes import Nodes, RehearsalError

PAUSE = partial(Event().wait, 0.05)
SUPERVISOR = """
import sys, time
from pathlib import Path
from fss_rehearsal.domain import Domain
from fss_rehearsal.processes import Nodes
domain = Domain(int(sys.argv[2]), "/", None)
with Nodes(Path(sys.argv[1]), print, domain) as nodes:
    nodes.start("testbed", "fss_sim", "testbed", ports=domain.ports(4))
    for i, url in enumerate(domain.urls(4), 1):
        nodes.start(f"link_{i}", "fss_arm_driver", "link", link=i, url=url)
    nodes.start("arm", "fss_arm_driver", "arm")
    nodes.run("deaf", ["/bin/sh", "-c", "trap 'echo told' TERM; while :; do sleep 0.1; done"])
    print(*(process.pid for process in nodes.processes.values()), flush=True)
    time.sleep(600)
"""


def alive(pid):
    """Whether a process runs: one that nobody has asked about yet has ended all the same."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_all_nodes_end_with_a_supervisor_that_is_killed(spin, tmp_path):
    ears, heard = Node("ears"), set()
    for i in range(1, 5):
        ears.create_subscription(
            LinkTelemetry, f"link_{i}/telemetry", lambda m: heard.add(m.link), SENSOR
        )
    arm = ears.create_client(SetBool, "arm/enable")
    command = [sys.executable, "-c", SUPERVISOR, tmp_path, str(DOMAIN)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as supervisor:
        pids = [int(pid) for pid in supervisor.stdout.readline().split()]
        spin(ears, lambda: len(heard) == 4 and arm.service_is_ready(), 60.0)
        assert sum(map(alive, pids)) == 7
        os.kill(pids[1], signal.SIGSTOP)
        supervisor.kill()
        killed = monotonic()
        wait_until(lambda: not any(map(alive, pids)), 5.0, PAUSE)
        assert monotonic() - killed < 5.0
    assert "told\n" in (tmp_path / "deaf.log").read_text()  # before it was killed


def test_a_killed_node_is_started_again_but_not_for_ever_and_a_failed_one_never(tmp_path):
    said = []
    with Nodes(tmp_path, said.append, OWN) as nodes:

        def kill():
            nodes.processes["a"].kill()
            nodes.processes["a"].wait()

        nodes.run("a", ["/bin/sh", "-c", "exec sleep 60"])
        for _ in range(4):
            kill()
            nodes.restart_killed()
        assert said == ["node a was killed (SIGKILL), restarting it"] * 4
        kill()
        with pytest.raises(RehearsalError, match="node a exited with code -9: "):
            nodes.restart_killed()
        nodes.run("a", ["/bin/sh", "-c", "echo no such arm; exit 1"])
        nodes.processes["a"].wait()
        with pytest.raises(RehearsalError, match="node a exited with code 1: no such arm"):
            nodes.restart_killed()
