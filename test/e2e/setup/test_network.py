"""Two computers and a stranger on one network, as network namespaces."""

import os
import shutil
import subprocess
from functools import partial
from pathlib import Path
from threading import Event

import pytest
from running import DOMAIN, wait_until

from fss_arm_bags.reader import BagError, open_bags

ROOT = Path(__file__).resolve().parents[3]
HOSTS = {"fss": "10.77.0.1", "ground": "10.77.0.2", "stranger": "10.77.0.3"}
PAUSE = partial(Event().wait, 0.2)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.geteuid() != 0 or not shutil.which("ip"), reason="needs root and the command ip"
    ),
]


def ip(*words):
    subprocess.run(["ip", *words], check=True)


@pytest.fixture
def network():
    """The namespaces' names by host, on a bridge, each with its own loopback."""
    names = {host: f"fss_{host}_{os.getpid()}" for host in (*HOSTS, "switch")}
    switch = names["switch"]
    try:
        for name in names.values():
            ip("netns", "add", name)
        ip("-n", switch, "link", "add", "bridge", "type", "bridge")
        ip("-n", switch, "link", "set", "bridge", "up")
        for host, address in HOSTS.items():
            name = names[host]
            ip("link", "add", "eth", "netns", name, "type", "veth", "peer", host, "netns", switch)
            ip("-n", switch, "link", "set", host, "master", "bridge", "up")
            ip("-n", name, "address", "add", f"{address}/24", "dev", "eth")
            ip("-n", name, "link", "set", "eth", "up")
            ip("-n", name, "link", "set", "lo", "up")
            ip("-n", name, "route", "add", "224.0.0.0/4", "dev", "eth")  # multicast
        yield names
    finally:
        for name in names.values():
            subprocess.run(["ip", "netns", "delete", name], check=False)


@pytest.fixture
def run(network, tmp_path):
    """run(host, settings, command): a shell on a host, as a user has it after env.sh."""
    started = []
    kept = {k: v for k, v in os.environ.items() if k not in ("FASTRTPS_DEFAULT_PROFILES_FILE",)}
    kept["ROS_DOMAIN_ID"] = str(DOMAIN)
    del kept["ROS_AUTOMATIC_DISCOVERY_RANGE"]

    def begin(host, settings, command):
        script = f". {ROOT}/scripts/env.sh; exec {command}"
        with (tmp_path / f"{len(started)}.log").open("wb") as log:
            started.append(
                subprocess.Popen(
                    ["ip", "netns", "exec", network[host], "bash", "-c", script],
                    stdout=log,
                    stderr=log,
                    env=kept | settings,
                )
            )

    yield begin
    for process in started:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def poses(bags):
    """How many poses of the base a folder of bags has."""
    try:
        with open_bags(bags) as read:
            topic = read.topics.get("/vicon/fss/fss")
            return topic.messages if topic else 0
    except BagError:  # not begun yet
        return 0


@pytest.mark.parametrize("how", ["peers", "server"])
def test_two_computers_hear_each_other_and_a_stranger_neither(run, tmp_path, how):
    subnet = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    if how == "peers":
        settings = {"ROS_STATIC_PEERS": f"{HOSTS['fss']};{HOSTS['ground']}"}
    else:
        server = f"{HOSTS['fss']}:11811"
        settings = {"ROS_DISCOVERY_SERVER": server, "ROS_SUPER_CLIENT": "TRUE", **subnet}
        run("fss", {}, f"fast-discovery-server -i 0 -l {HOSTS['fss']} -p 11811")
    run("fss", settings, "ros2 run fss_sim testbed")
    for host, reach in (("ground", settings), ("fss", settings), ("stranger", subnet)):
        named = f"-r __node:=record_{host} -p output:={tmp_path / host}"  # of one name is but one
        run(host, reach, f"ros2 run fss_arm_bags record --ros-args {named}")
    for host in ("ground", "fss"):
        wait_until(lambda host=host: poses(tmp_path / host) > 200, 60, PAUSE)
    # The stranger has listened as long as they.
    assert list((tmp_path / "stranger").iterdir())
    assert poses(tmp_path / "stranger") == 0
