"""What is killed in the midst of a move: the simulated links stop by themselves, in time."""

import os
import signal
import time
from pathlib import Path

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_sim import testbed_node

WATCHDOG = 2.0
KEYS = "".join(f"{i} {i:02x}{'5a' * 19}\n" for i in (1, 2, 3, 4))


class User(Node):
    """Arms link 1 and commands it."""

    def __init__(self):
        super().__init__("user")
        self.telemetry = []
        self.create_subscription(LinkTelemetry, "link_1/telemetry", self.telemetry.append, 100)
        self.command = self.create_publisher(LinkCommand, "link_1/command", 1)
        self.arm = self.create_client(SetBool, "link_1/arm")

    def turn(self):
        """Slowly, and in force for longer than the test."""
        message = LinkCommand(mode=LinkCommand.VELOCITY, set_point=0.1, time_to_live=60.0)
        message.header.stamp = self.get_clock().now().to_msg()
        self.command.publish(message)


def test_a_killed_driver_leaves_a_link_that_stops(spin, start, tmp_path):
    keys = tmp_path / "keys"
    keys.write_text(KEYS)
    keys.chmod(0o600)
    settings = {"ports": [0, 0, 0, 0], "keys": str(keys)}
    bed = testbed_node.TestbedNode(
        parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    user, port = User(), bed.wires[0].port
    driver = start(
        "fss_arm_driver.link_node", "--ros-args", "-p", f"keys:={keys}",
        "-p", f"url:=udp://127.0.0.1:{port}?bind=0", "-p", f"watchdog:={WATCHDOG}",
    )  # fmt: skip
    nodes, plant = [bed, user], bed.testbed.plant
    link = bed.testbed.links[0].electronics
    spin(nodes, lambda: user.telemetry and user.arm.service_is_ready(), 30.0)
    spin(nodes, user.command.get_subscription_count)

    answers = []

    def arm():
        if not answers or answers[-1].done():
            answers.append(user.arm.call_async(SetBool.Request(data=True)))
        return user.telemetry[-1].armed

    spin(nodes, arm, 20.0)
    spin(nodes, lambda: user.turn() or plant.qd[3] > 0.08, 20.0)
    driver.process.send_signal(signal.SIGKILL)
    killed, frame = time.monotonic(), bed.testbed.frame
    driver.wait()
    moving = plant.qd[3]
    spin(nodes, lambda: abs(plant.qd[3]) < 1e-3, WATCHDOG + 10.0)
    simulated = (bed.testbed.frame - frame) * 0.01
    assert moving > 0.08
    assert link.watchdog_tripped
    assert not link.armed
    # The last command may have come right before the kill; then the joint decelerates.
    assert WATCHDOG - 0.3 < simulated < WATCHDOG + 0.3
    assert time.monotonic() - killed > WATCHDOG - 0.3
    assert user.telemetry[-1].flags & State.ARMED  # the last that the dead driver said


class Pair:
    """Links 1 and 2 of a simulated test bed, a driver each, and who commands their paths."""

    def __init__(self, spin, start):
        bed = testbed_node.TestbedNode(parameter_overrides=[Parameter("ports", value=4 * [0])])
        self.spin, self.start, self.bed, self.user = spin, start, bed, Node("user")
        self.nodes, self.plant = [bed, self.user], bed.testbed.plant
        self.links = [bed.testbed.links[i].electronics for i in (0, 1)]
        self.arming = {i: self.user.create_client(SetBool, f"link_{i}/arm") for i in (1, 2)}
        self.drivers = {i: self.driver(i) for i in (1, 2)}
        self.armed(1, 2)

    def driver(self, i):
        url = f"udp://127.0.0.1:{self.bed.wires[i - 1].port}?bind=0"
        parameters = "-p", f"link:={i}", "-p", f"url:={url}", "-p", f"watchdog:={WATCHDOG}"
        parameters += "-p", "timeout:=5.0"  # whatever else the machine does
        return self.start("fss_arm_driver.link_node", "--ros-args", *parameters)

    def person(self, number):
        support = str(Path(__file__).parents[2] / "support")
        place = os.pathsep.join([support, os.environ.get("PYTHONPATH", "")])
        return self.start("path_person", number, PYTHONPATH=place)

    def until(self, condition, timeout=20.0):
        return self.spin(self.nodes, condition, timeout)

    def armed(self, *links):
        """Arm links; a driver that has just begun may not answer the first time."""
        for i in links:
            asked, answers = -1e9, []

            def done(i=i, answers=answers):
                nonlocal asked
                if self.arming[i].service_is_ready() and time.monotonic() > asked + 3.0:
                    answers.append(self.arming[i].call_async(SetBool.Request(data=True)))
                    asked = time.monotonic()
                return any(answer.done() and answer.result().success for answer in answers)

            self.until(done, 40.0)

    def following(self):
        return all(link.paths.following for link in self.links) and min(self.rates()) > 0.04

    def rates(self):
        return [abs(rate) for rate in self.plant.qd[3:5]]

    def rested(self, *joints):
        """How long the joints took to come to rest, in the test bed's time [s]."""
        frame = self.bed.testbed.frame
        self.until(lambda: all(self.rates()[k] < 1e-3 for k in joints), WATCHDOG + 10.0)
        return 0.01 * (self.bed.testbed.frame - frame)

    def fastest(self, seconds):
        """The highest rates for so long."""
        end, most = self.bed.testbed.frame + 100 * seconds, [0.0, 0.0]

        def over():
            most[:] = map(max, most, self.rates())
            return self.bed.testbed.frame > end

        self.until(over, 20.0 + seconds)
        return most


@pytest.fixture
def pair(spin, start):
    return Pair(spin, start)


def test_who_commands_a_path_is_killed_and_all_joints_rest_until_another_is_given(pair):
    person = pair.person(1)
    pair.until(pair.following)
    person.stop(signal.SIGKILL)
    assert pair.rested(0, 1) < WATCHDOG + 0.3
    assert all(link.armed and not link.paths.followed for link in pair.links)
    pair.person(1)  # path 1 is over, and begins no more
    assert max(pair.fastest(3.0)) < 1e-3
    pair.person(2)
    fastest = []
    pair.until(lambda: fastest.append(max(pair.rates())) or pair.following())
    assert max(fastest) < 0.08  # its own: no jump


def test_a_killed_driver_rests_its_link_and_its_path_does_not_go_on(pair):
    pair.person(1)
    pair.until(pair.following)
    pair.drivers[2].stop(signal.SIGKILL)
    assert pair.rested(1) < WATCHDOG + 0.3
    pair.until(lambda: pair.links[1].watchdog_tripped)  # its command expired a little earlier
    assert pair.links[1].paths.report == 0
    assert pair.links[0].paths.following
    pair.drivers[2] = pair.driver(2)
    assert pair.fastest(2.0)[1] < 0.01  # without power it drifts a little as the other one moves
    pair.armed(2)
    assert pair.fastest(2.0)[1] < 1e-3  # path 1 of the dead driver is not known any more
    pair.until(lambda: not pair.links[0].paths.following, 30.0)
    assert pair.rested(0, 1) < 0.5
