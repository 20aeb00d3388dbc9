"""The driver's node and the firmware's own code: a link that is left alone stops by itself."""

import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from firmware import build
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from fss_arm_driver.protocol import State, Telemetry, decode
from fss_arm_driver.transport import open_transport
from fss_arm_msgs.msg import LinkCommand
from fss_arm_ros.qos import COMMAND, subscribe_sensor

KEY = bytes(range(16))
SECOND = 1_000_000


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    path = tmp_path / "keys"
    path.touch(0o600)
    path.write_text(f"1 {KEY.hex()}\n")
    return path


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(params=["--udp 0", "--pty"])
def url(request, keys) -> Iterator[str]:
    """Where the firmware, as a process, is."""
    command = [build("fss_link"), "--link", "1", *request.param.split(), "--keys", str(keys)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as link:
        told = link.stdout.readline()  # "link 1 at udp 40001, signed"
        place = told.split()[4].rstrip(",")
        udp = f"udp://127.0.0.1:{place}?bind={free_port()}"
        yield udp if "udp" in told else f"serial://{place}"
        link.kill()


class Person(Node):
    """Arms a link, turns it, and sees its joint."""

    def __init__(self):
        super().__init__("person")
        self.joint = None
        subscribe_sensor(self, JointState, "joint_states", self.see)
        self.arming = self.create_client(SetBool, "link_1/arm")
        self.commands = self.create_publisher(LinkCommand, "link_1/command", COMMAND)

    def see(self, joint):
        self.joint = joint

    def turn(self):
        """To the end of the range, slowly; in force for longer than that takes."""
        command = LinkCommand(mode=LinkCommand.POSITION, set_point=1.5)
        command.max_velocity, command.time_to_live = 0.2, 60.0
        self.commands.publish(command)

    def turning(self):
        """Whether it does."""
        self.turn()
        return self.joint.velocity[0] > 0.15


def test_a_link_whose_driver_was_killed_stops_within_the_watchdog_time(spin, start, url, keys):
    parameters = ("-p", "link:=1", "-p", f"url:={url}", "-p", f"keys:={keys}")
    driver = start("fss_arm_driver.link_node", "--ros-args", *parameters)
    person = Person()
    spin(person, lambda: person.joint and person.arming.service_is_ready(), 30.0)
    armed = person.arming.call_async(SetBool.Request(data=True))
    assert spin(person, armed.done, 20.0)
    assert armed.result().success, armed.result().message
    spin(person, person.turning, 20.0)
    driver.stop(signal.SIGKILL)

    transport = open_transport(url)
    frames: list[Telemetry] = []

    def listen() -> bool:
        transport.wait(0.1)
        frames.extend(decode(data, KEY) for data in transport.receive())
        return bool(frames) and frames[-1].turnaround > 3.5 * SECOND

    spin(person, listen, 20.0)
    transport.close()
    tripped = [frame for frame in frames if frame.flags & State.WATCHDOG]
    before = [frame for frame in frames if not frame.flags & State.WATCHDOG]
    assert all(frame.velocity > 0 for frame in before)
    assert before[-1].turnaround <= 2.0 * SECOND
    assert tripped[0].turnaround < 3.5 * SECOND  # a stall of this machine included
    assert tripped[-1].velocity == 0
    assert not tripped[-1].flags & State.ARMED
    assert tripped[-1].position < 50_000  # of the 57 000 counts commanded
