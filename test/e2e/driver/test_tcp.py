"""A link on TCP, with its firmware: connections cut, silent, too many."""

import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from threading import Thread

import pytest
from firmware import build
from running import free_port
from turn_person import TurnPerson

from fss_arm_driver.link_node import LinkNode
from fss_link.transport import readable

LOST = 3.0  # [s]


@pytest.fixture
def port() -> Iterator[int]:
    """Where link 1 listens."""
    port = free_port()
    with subprocess.Popen([build("fss_link"), "--link", "1", "--tcp", str(port)]) as link:
        yield port
        link.kill()


class Cable(Thread):
    """Passes on what comes at its port. Tugged, it hangs up once."""

    def __init__(self, to: int) -> None:
        super().__init__(daemon=True)
        self.to, self.tug, self.closing = to, False, False
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
            if self.tug:
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


@pytest.fixture
def cable(port: int) -> Iterator[Cable]:
    with closing(Cable(port)) as made:
        yield made


@pytest.fixture
def link(spin, port: int, cable: Cable) -> tuple[LinkNode, TurnPerson]:
    """A driver at the other end of the cable, its link armed and turning."""
    made, person = LinkNode(1, f"tcp://127.0.0.1:{cable.port}"), TurnPerson(0.1)
    arm(spin, made, person)
    return made, person


def arm(spin, link: LinkNode, person: TurnPerson) -> None:
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
