"""A link on TCP, with its firmware: other connections do not stop it."""

import socket
import subprocess
import time
from contextlib import suppress

from firmware import build
from running import free_port
from turn_person import TurnPerson

from fss_arm_driver.link_node import LinkNode

RATE, DURATION = 0.1, 2.0  # [rad/s], [s]


def test_others_that_connect_do_not_stop_a_link_that_moves(spin):
    port, others = free_port(), []
    with subprocess.Popen([build("fss_link"), "--link", "1", "--tcp", str(port)]) as firmware:
        link, person = LinkNode(1, f"tcp://127.0.0.1:{port}"), TurnPerson(RATE)
        nodes = [link, person]
        spin(nodes, lambda: not link.session.obstacle(link.now()), 20.0)
        link.session.arm(link.now())
        spin(nodes, lambda: link.session.armed)
        spin(nodes, person.turning)
        begin, start = person.joint.position[0], time.monotonic()
        connects = link.transport.counts["connects"]
        while time.monotonic() < start + DURATION:
            others.append(socket.create_connection(("127.0.0.1", port), 5.0))
            if len(others) % 2:
                with suppress(OSError):
                    others[-1].sendall(b"\0GET / HTTP/1.1\r\n\r\n\0" * 50)
            until = time.monotonic() + 0.1
            spin(nodes, lambda until=until: time.monotonic() > until)
            assert person.turning()
        for other in others:
            other.close()
        assert link.session.armed
        assert link.transport.counts["connects"] == connects
        assert person.joint.position[0] - begin > 0.5 * RATE * DURATION
        firmware.kill()
