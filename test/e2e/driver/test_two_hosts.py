"""Two hosts and a bad network: the link in a network namespace of its own at the end of a cable.

The driver's datagrams go through a relay that loses, delays, repeats and reorders them, and through
a virtual cable, which is pulled for half a minute.
"""

import os
import shutil
import subprocess
import sys
import time
from math import sqrt
from pathlib import Path

import pytest
from driver_network import SECOND, Network, Relay
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from fss_arm_driver.protocol import LinkCommandFlag
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.convert import stamp_ns

HOST, LINK, PORT = "10.213.45.1", "10.213.45.2", 5001
CABLE = f"fss{os.getpid() % 10_000}"
LINK_PROCESS = Path(__file__).parents[2] / "support/link_process.py"


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


def can_make_namespaces():
    if os.geteuid() or not shutil.which("ip"):
        return False
    name = f"{CABLE}probe"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False)
    subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
    return made.returncode == 0


@pytest.fixture
def far_link(tmp_path):
    """The log of a link at LINK, in another namespace."""
    ip("netns", "add", CABLE)
    try:
        ip("link", "add", CABLE, "type", "veth", "peer", "name", "far", "netns", CABLE)
        ip("addr", "add", f"{HOST}/24", "dev", CABLE)
        ip("link", "set", CABLE, "up")
        ip("-n", CABLE, "addr", "add", f"{LINK}/24", "dev", "far")
        ip("-n", CABLE, "link", "set", "far", "up")
        log = tmp_path / "link.log"
        inside = ["ip", "netns", "exec", CABLE, sys.executable, str(LINK_PROCESS)]
        process = subprocess.Popen([*inside, LINK, str(PORT), str(log)])
        yield log
        process.kill()
        process.wait()
    finally:
        ip("netns", "del", CABLE)


def entries(log, kind):
    lines = [line.split() for line in log.read_text().splitlines()]
    return [list(map(float, line[1:])) for line in lines if line[0] == kind and len(line) > 3]


def rms(values):
    return sqrt(sum(value**2 for value in values) / len(values))


class User(Node):
    """Hears one link, and commands it five times a second while it shall."""

    def __init__(self):
        super().__init__("user")
        self.joints, self.telemetry, self.target = [], [], None
        self.create_subscription(JointState, "joint_states", self.hear, 100)
        self.create_subscription(LinkTelemetry, "link_1/telemetry", self.telemetry.append, 100)
        self.command = self.create_publisher(LinkCommand, "link_1/command", 1)
        self.arm = self.create_client(SetBool, "link_1/arm")
        self.create_timer(0.2, self.order)

    def hear(self, message):
        self.joints.append((time.time_ns(), message))

    def order(self):
        if self.target is not None:
            message = LinkCommand(mode=21, set_point=self.target, time_to_live=0.5)
            message.header.stamp = self.get_clock().now().to_msg()
            self.command.publish(message)


@pytest.mark.slow
@pytest.mark.skipif(not can_make_namespaces(), reason="network namespaces need root and ip")
def test_two_hosts_and_a_bad_network(spin, start, far_link, capsys):
    network, user = Network(), User()
    relay = Relay((LINK, PORT), network, "0.0.0.0")
    url = f"udp://127.0.0.1:{relay.port}?bind=0"
    start("fss_arm_driver.link_node", "--ros-args", "-p", f"url:={url}")

    def seconds(duration):
        end = time.monotonic() + duration
        spin([user], lambda: time.monotonic() > end, duration + 10.0)

    spin([user], lambda: user.telemetry and user.arm.service_is_ready(), 30.0)
    answer = user.arm.call_async(SetBool.Request(data=True))
    spin([user], answer.done)
    user.target = 1.2
    seconds(60.0)
    user.target = None
    ip("link", "set", CABLE, "down")
    pulled = time.time_ns()
    seconds(30.0)
    ip("link", "set", CABLE, "up")
    back = time.time_ns()
    seconds(10.0)
    relay.close()

    truth = {
        int(sequence): (at, position) for sequence, at, position in entries(far_link, "measured")
    }
    sequences = [message.sequence for message in user.telemetry]
    assert sequences == sorted(set(sequences))
    errors, first = [], user.telemetry[0].clock
    for message in user.telemetry:
        at, position = truth[message.sequence]
        assert message.position == position
        errors.append((stamp_ns(message.header.stamp) - at) / SECOND)
    # The first seconds know the clock less well, and say so.
    settled = [e for e, m in zip(errors, user.telemetry, strict=True) if m.clock > first + 10e6]
    deviation, settled = rms(errors), rms(settled)
    ages = [(heard - stamp_ns(message.header.stamp)) / SECOND for heard, message in user.joints]
    outage = [heard for heard, _ in user.joints if pulled + SECOND / 2 < heard < back]
    recovery = (min(heard for heard, _ in user.joints if heard > back) - back) / SECOND
    rate = len([1 for heard, _ in user.joints if heard < pulled]) / 60.0
    taken = entries(far_link, "taken")
    armed = [left for _, _, flags, left in taken if int(flags) & LinkCommandFlag.ARM]
    with capsys.disabled():
        print(
            f"\n  stamps deviate by {1e3 * settled:.2f} ms (1 sigma), with the first "
            f"10 s {1e3 * deviation:.2f} ms; joint states at {rate:.2f} Hz, 4 Hz sent through; "
            f"oldest {max(ages):.2f} s; recovery {recovery:.2f} s after 30 s; {len(armed)} armed "
            "commands executed"
        )
    assert settled < 5e-3
    assert max(ages) < 1.5  # a second of it at most on the way, the rest in this machine
    assert not outage
    assert recovery < 1.0
    assert rate > 3.5
    order = [sequence for sequence, *_ in taken]
    assert order == sorted(set(order))
    assert len(armed) > 100
    assert min(armed) >= 0
