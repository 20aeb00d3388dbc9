"""A link on TCP, the firmware's or the test bed's: connections cut, silent, too many."""

import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from threading import Thread

import pytest
from firmware import build
from rclpy.node import Node
from running import free_port
from sensor_msgs.msg import JointState

from fss_arm_driver.link_node import LinkNode
from fss_arm_msgs.msg import LinkCommand
from fss_arm_ros.qos import COMMAND, subscribe_sensor
from fss_link.transport import readable

LOST, STOPPED = 3.0, 4.0  # [s]


@pytest.fixture(params=["fss_link", "testbed"])
def port(request, start) -> Iterator[int]:
    """Where link 1 listens."""
    port = free_port()
    if request.param == "testbed":
        ports = [port, free_port(), free_port(), free_port()]
        start("fss_sim.testbed_node", "--ros-args", "-p", "transports:=[tcp]", "-p",
              f"ports:={ports}")  # fmt: skip
        yield port
    else:
        with subprocess.Popen([build("fss_link"), "--link", "1", "--tcp", str(port)]) as link:
            yield port
            link.kill()


class Cable(Thread):
    """Passes on what comes at its port. Tugged, it hangs up once; cut, on whoever connects."""

    def __init__(self, to: int) -> None:
        super().__init__(daemon=True)
        self.to, self.tug, self.cut, self.closing = to, False, False, False
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.pairs: dict[socket.socket, socket.socket] = {}
        self.start()

    def run(self) -> None:
        while not self.closing:
            for line in readable([self.listener, *self.pairs], 0.01):
                if line is self.listener:
                    self.join_ends(line.accept()[0])
                elif line in self.pairs:
                    self.pass_on(line)
            if self.cut or self.tug:
                self.hang_up()
                self.tug = False
        self.hang_up()
        self.listener.close()

    def join_ends(self, near: socket.socket) -> None:
        try:
            far = socket.create_connection(("127.0.0.1", self.to), 5.0)
        except OSError:
            near.close()
        else:
            self.pairs |= {near: far, far: near}

    def pass_on(self, line: socket.socket) -> None:
        with suppress(OSError):
            if data := line.recv(4096):
                self.pairs[line].sendall(data)
                return
        self.hang_up()

    def hang_up(self) -> None:
        for line in self.pairs:
            line.close()
        self.pairs = {}

    def close(self) -> None:
        self.closing = True
        self.join()


class Person(Node):
    """Turns the link, and sees it."""

    def __init__(self) -> None:
        super().__init__("person")
        self.joint: JointState | None = None
        self.commanded = 0.0
        subscribe_sensor(self, JointState, "joint_states", self.see)
        self.commands = self.create_publisher(LinkCommand, "link_1/command", COMMAND)

    def see(self, joint: JointState) -> None:
        self.joint = joint

    def turning(self) -> bool:
        """Whether it does; told now and again to, slowly."""
        if time.monotonic() > self.commanded + 0.2:
            self.commanded = time.monotonic()
            command = LinkCommand(mode=LinkCommand.POSITION, set_point=1.5, max_velocity=0.1)
            command.time_to_live = 60.0
            self.commands.publish(command)
        return self.joint is not None and self.joint.velocity[0] > 0.05


@pytest.fixture
def cable(port: int) -> Iterator[Cable]:
    with closing(Cable(port)) as made:
        yield made


@pytest.fixture
def link(spin, port: int, cable: Cable) -> tuple[LinkNode, Person]:
    """A driver at the other end of the cable, its link armed and turning."""
    made, person = LinkNode(1, f"tcp://127.0.0.1:{cable.port}"), Person()
    arm(spin, made, person)
    return made, person


def arm(spin, link: LinkNode, person: Person) -> None:
    spin([link, person], lambda: not link.session.obstacle(link.now()), 20.0)
    link.session.arm(link.now())
    spin([link, person], lambda: link.session.armed)
    spin([link, person], person.turning)


def passed(seconds: float):
    """A condition that holds once so much time has passed."""
    until = time.monotonic() + seconds
    return lambda: time.monotonic() > until


def test_others_that_connect_do_not_stop_a_link_that_moves(spin, port, link):
    begin, over = link[1].joint.position[0], passed(LOST)
    connects = link[0].transport.counts["connects"]
    others = []
    while not over():
        others.append(socket.create_connection(("127.0.0.1", port), 5.0))
        if len(others) % 2:
            with suppress(OSError):
                others[-1].sendall(b"\0GET / HTTP/1.1\r\n\r\n\0" * 50)
        spin(link, passed(0.1))
        assert link[1].turning()
    for other in others:
        other.close()
    assert link[0].session.armed
    assert link[0].transport.counts["connects"] == connects
    assert link[1].joint.position[0] - begin > 0.5 * 0.1 * LOST


def test_a_connection_that_is_cut_and_comes_again_at_once_stops_nothing(spin, cable, link):
    connects = link[0].transport.counts["connects"]
    for _ in range(2):
        cable.tug = True
        spin(link, lambda: not cable.tug)
        spin(link, passed(0.5))
        assert link[0].session.armed
        assert link[1].turning()
    assert link[0].transport.counts["connects"] >= connects + 2


def test_one_that_is_cut_for_long_stops_the_link_by_its_watchdog(spin, cable, link):
    link_node, person = link
    cable.cut = True
    spin(link, passed(STOPPED))
    assert link_node.session.lost
    cable.cut = False
    before = person.joint
    spin(link, lambda: not link_node.session.obstacle(link_node.now()) and person.joint != before)
    assert not link_node.session.armed
    assert abs(person.joint.velocity[0]) < 1e-3
    assert person.joint.position[0] < 0.6  # of the 1.5 that were commanded
    arm(spin, link_node, person)


def test_a_link_whose_process_starts_again_is_found_again(spin):
    port = free_port()
    begin = [build("fss_link"), "--link", "1", "--tcp", str(port)]
    first = subprocess.Popen(begin)
    link, person = LinkNode(1, f"tcp://127.0.0.1:{port}"), Person()
    arm(spin, link, person)
    first.kill()
    first.wait()
    spin([link, person], lambda: link.session.lost)
    with subprocess.Popen(begin) as second:
        arm(spin, link, person)
        second.kill()
