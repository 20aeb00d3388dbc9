"""Paths in time through nodes and datagrams, and what is killed in the midst of them."""

import os
import signal
import time
from pathlib import Path

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from fss_sim import testbed_node

WATCHDOG = 2.0


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


def test_loss_jitter_and_an_outage_cost_no_knot(pair):
    faults = pair.bed.testbed.faults
    for name, value in {"loss": 0.2, "delay": 0.03, "jitter": 0.03}.items():
        for part in ("link_1", "link_2"):
            faults.set(part, name, value)
    pair.armed(1, 2)  # again, if the loss has disarmed one
    pair.person(1)
    pair.until(pair.following)
    pair.fastest(2.0)
    for loss, lasts in ((1.0, 1.0), (0.2, 1.0)):
        for part in ("link_1", "link_2"):
            faults.set(part, "loss", loss)
        pair.fastest(lasts)
    assert all(link.paths.following for link in pair.links)
    pair.until(lambda: not any(link.paths.following for link in pair.links), 30.0)
    assert all(link.paths.followed == 1 and not link.paths.broken for link in pair.links)
