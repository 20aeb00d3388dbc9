"""Datagrams over the loopback interface."""

import socket

import pytest

from fss_arm_driver.transport import BATCH, TransportError, UdpTransport, open_transport


@pytest.fixture
def peer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        yield peer


@pytest.fixture
def udp(peer):
    transport = open_transport(f"udp://127.0.0.1:{peer.getsockname()[1]}?bind=0")
    yield transport
    transport.close()


def home(udp):
    return "127.0.0.1", udp.port


def test_both_ways(peer, udp):
    udp.send(b"down")
    data, source = peer.recvfrom(100)
    assert (data, source) == (b"down", home(udp))
    peer.sendto(b"up", source)
    assert udp.wait(5.0)
    assert udp.receive() == [b"up"]
    assert udp.receive() == []
    assert not udp.wait(0.0)


def test_strangers_are_counted_and_not_heard(peer, udp):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"hello", home(udp))
    assert udp.wait(5.0)
    assert udp.receive() == []
    assert udp.counts["strangers"] == 1


def test_a_flood_is_read_in_batches_and_long_datagrams_are_cut(peer, udp):
    for _ in range(BATCH + 1):
        peer.sendto(bytes(1000), home(udp))
    assert udp.wait(5.0)
    assert [len(data) for data in udp.receive()] == [73] * BATCH
    assert len(udp.receive()) == 1


def test_a_peer_that_refuses_may_come_later(udp, peer):
    port = peer.getsockname()[1]
    peer.close()
    for _ in range(3):
        udp.send(b"nobody there")
    assert udp.receive() == []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as back:
        back.bind(("127.0.0.1", port))
        back.sendto(b"up", home(udp))
        assert udp.wait(5.0)
        assert udp.receive() == [b"up"]


def test_what_cannot_be_sent_is_counted(udp):
    udp.send(bytes(100_000))
    assert udp.counts["send_failures"] == 1


def test_a_closed_transport_does_nothing(udp):
    udp.close()
    udp.send(b"x")
    assert udp.receive() == []
    assert not udp.wait(0.0)


@pytest.mark.parametrize(
    "url",
    [
        "",
        "127.0.0.1:5001",
        "udp://127.0.0.1",
        "udp://127.0.0.1:0",
        "udp://127.0.0.1:70000",
        "udp://:5001",
        "udp://127.0.0.1:5001?bind=x",
        "udp://127.0.0.1:5001?bind=70000",
        "udp://127.0.0.1:5001?bnd=6001",
        "udp://127.0.0.1:5001/path",
        "tcp://127.0.0.1:5001",
    ],
)
def test_urls_that_name_no_transport_are_refused(url):
    with pytest.raises(TransportError, match=r"expected udp://HOST:PORT\?bind=PORT"):
        open_transport(url)


def test_a_taken_port_is_named(peer):
    port = peer.getsockname()[1]
    with pytest.raises(TransportError, match=rf"bind={port}' cannot be opened: Address already"):
        open_transport(f"udp://127.0.0.1:9?bind={port}")


def test_localhost_is_the_ipv4_one_if_there_are_two():
    transport = UdpTransport("localhost", 9)
    assert transport._socket.family == socket.AF_INET
    transport.close()
