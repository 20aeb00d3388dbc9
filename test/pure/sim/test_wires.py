"""What links are reached by: a pseudo-terminal as by RS-232, a TCP port."""

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
    far = os.open(terminal.place, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(far)
    yield far
    os.close(far)


def test_frames_pass_both_ways_once_somebody_is_known(terminal, driver):
    os.write(driver, b"noise" + pack(FRAME) + pack(FRAME)[:40])
    got = []
    while not got:  # the line takes its time
        got = terminal.receive()
    ((data, peer),) = got
    assert data == FRAME
    terminal.send(b"to nobody" * 8, None)
    terminal.send(FRAME[::-1], peer)
    decoder, frames = StreamDecoder(), []
    while not frames:
        frames = decoder.feed(os.read(driver, 1000))
    assert frames == [FRAME[::-1]]


def test_a_line_that_nobody_reads_blocks_nothing(terminal):
    for _ in range(1000):
        terminal.send(FRAME, terminal)


def test_its_path_goes_with_it_and_is_not_taken_from_others(tmp_path):
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
    """connect(): somebody connected to the listener."""
    lines = []

    def one():
        lines.append(socket.create_connection(("127.0.0.1", listener.port), 5.0))
        lines[-1].settimeout(5.0)
        return lines[-1]

    yield one
    for line in lines:
        line.close()


def frames(wire, count=1):
    """What comes until there are so many frames."""
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
    listener.send(FRAME[::-1], None)  # nobody is known: to who is there
    listener.send(FRAME[::-1], peer)
    decoder, got = StreamDecoder(), []
    while len(got) < 2:
        got += decoder.feed(driver.recv(1000))
    assert got == 2 * [FRAME[::-1]]


def test_who_connects_and_sends_nothing_or_noise_takes_telemetry_from_nobody(listener, connect):
    driver = connect()
    driver.sendall(pack(FRAME))
    ((_, peer),) = frames(listener)
    silent, noisy = connect(), connect()
    noisy.sendall(b"\0GET / HTTP/1.1\r\n\r\n\0" * 100)
    for _ in range(20):  # of those in the way
        connect()
        listener.receive()
    listener.send(FRAME, peer)
    assert StreamDecoder().feed(driver.recv(1000)) == [FRAME]
    for other in (silent, noisy):  # their place was taken by those who came later
        with suppress(ConnectionError):
            assert other.recv(1000) == b""


def test_who_is_gone_is_forgotten_and_may_come_again(listener, connect):
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


def test_a_driver_that_reads_nothing_blocks_nothing_and_finds_whole_frames_later(listener, connect):
    driver = connect()
    driver.sendall(pack(FRAME))
    ((_, peer),) = frames(listener)
    for _ in range(100_000):  # more than the buffers hold
        listener.send(FRAME, peer)
    decoder, got = StreamDecoder(), []
    while len(got) < 100:
        got += decoder.feed(driver.recv(65536))
    assert set(got) == {FRAME}


def test_a_port_that_is_taken_is_refused_by_name(listener):
    with pytest.raises(OSError, match=f"TCP port {listener.port} of 127.0.0.1 cannot be opened"):
        LinkListener("127.0.0.1", listener.port)
