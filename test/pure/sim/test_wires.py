"""Connections to links: pseudo-terminals (like RS-232) and TCP ports."""

import os
import socket
import tty
from contextlib import suppress

import pytest
from running import wait_until

from fss_link.protocol import StreamDecoder, pack
from fss_sim.link.pty import LinkTerminal
from fss_sim.link.tcp import LinkListener

FRAME = bytes(range(72))


@pytest.fixture
def terminal(tmp_path):
    made = LinkTerminal(str(tmp_path / "link_1"))
    yield made
    made.close()


@pytest.fixture
def driver(terminal):
    far = os.open(terminal.address, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(far)
    yield far
    os.close(far)


def test_frames_pass_in_both_directions_once_the_peer_is_known(terminal, driver):
    os.write(driver, b"noise" + pack(FRAME) + pack(FRAME)[:40])
    got = []
    while not got:  # until the line has delivered it
        got = terminal.receive()
    ((data, peer),) = got
    assert data == FRAME
    terminal.send(b"to no peer" * 8, None)
    terminal.send(FRAME[::-1], peer)
    decoder, frames = StreamDecoder(), []
    while not frames:
        frames = decoder.feed(os.read(driver, 1000))
    assert frames == [FRAME[::-1]]


def test_an_unread_line_does_not_block(terminal):
    for _ in range(1000):
        terminal.send(FRAME, terminal)


def test_its_path_is_removed_on_close_unless_another_owns_it(tmp_path):
    path = tmp_path / "link_1"
    first = LinkTerminal(str(path))
    second = LinkTerminal(str(path))
    first.close()
    assert path.is_symlink()
    second.close()
    assert not path.is_symlink()
    path.write_text("mine")
    with pytest.raises(OSError, match="link_1 cannot be made"):
        LinkTerminal(str(path))


@pytest.fixture
def listener():
    made = LinkListener("127.0.0.1", 0)
    yield made
    made.close()


@pytest.fixture
def connect(listener):
    """connect(): return a socket connected to the listener."""
    lines = []

    def one():
        lines.append(socket.create_connection(("127.0.0.1", listener.port), 5.0))
        lines[-1].settimeout(5.0)
        return lines[-1]

    yield one
    for line in lines:
        line.close()


def frames(wire, count=1):
    """Return the received frames once there are `count`."""
    got = []
    wait_until(lambda: got.extend(wire.receive()) or len(got) >= count, 5.0, lambda: None)
    return got


def test_frames_pass_over_tcp_in_pieces_and_after_noise(listener, connect):
    driver = connect()
    driver.sendall(b"noise" + pack(FRAME)[:40])
    assert listener.receive() == []
    driver.sendall(pack(FRAME)[40:] + pack(FRAME))
    (first, peer), (second, same) = frames(listener, 2)
    assert (first, second, peer) == (FRAME, FRAME, same)
    listener.send(FRAME[::-1], None)  # no known peer: to the newest connection
    listener.send(FRAME[::-1], peer)
    decoder, got = StreamDecoder(), []
    while len(got) < 2:
        got += decoder.feed(driver.recv(1000))
    assert got == 2 * [FRAME[::-1]]


def test_connections_without_valid_frames_do_not_get_the_telemetry(listener, connect):
    driver = connect()
    driver.sendall(pack(FRAME))
    ((_, peer),) = frames(listener)
    silent, noisy = connect(), connect()
    noisy.sendall(b"\0GET / HTTP/1.1\r\n\r\n\0" * 100)
    for _ in range(20):  # more connections than allowed
        connect()
        listener.receive()
    listener.send(FRAME, peer)
    assert StreamDecoder().feed(driver.recv(1000)) == [FRAME]
    for other in (silent, noisy):  # replaced by later connections
        with suppress(ConnectionError):
            assert other.recv(1000) == b""


def test_a_closed_connection_is_dropped_and_may_reconnect(listener, connect):
    driver = connect()
    driver.sendall(pack(FRAME))
    ((_, peer),) = frames(listener)
    driver.close()
    for _ in range(5):
        listener.send(FRAME, peer)
        listener.receive()
    again = connect()
    again.sendall(pack(FRAME))
    ((_, peer),) = frames(listener)
    listener.send(FRAME[::-1], peer)
    assert StreamDecoder().feed(again.recv(1000)) == [FRAME[::-1]]


def test_a_driver_that_does_not_read_does_not_block_and_gets_whole_frames_later(listener, connect):
    driver = connect()
    driver.sendall(pack(FRAME))
    ((_, peer),) = frames(listener)
    for _ in range(50_000):  # more than the buffers hold
        listener.send(FRAME, peer)
    decoder, got = StreamDecoder(), []
    while len(got) < 100:
        got += decoder.feed(driver.recv(65536))
    assert set(got) == {FRAME}


def test_a_port_in_use_is_rejected_by_name(listener):
    with pytest.raises(OSError, match=f"TCP port {listener.port} of 127.0.0.1 cannot be opened"):
        LinkListener("127.0.0.1", listener.port)
