"""How datagrams reach a link. The driver's nodes know only `Transport`; URLs choose which one."""

import socket
from collections import Counter
from select import select
from typing import Protocol
from urllib.parse import parse_qs, urlsplit

from fss_arm_driver.protocol import FRAME_SIZE

BATCH = 64  # datagrams read at once, so that a flood cannot keep a node from its other work


class TransportError(ValueError):
    """A URL that names no transport, or one that cannot be opened."""


class Transport(Protocol):
    """Datagrams to and from one link. Nothing but `wait` blocks, and nothing raises once open."""

    counts: Counter[str]

    def send(self, data: bytes) -> None:
        """Send a datagram; what cannot be sent is counted and dropped."""

    def receive(self) -> list[bytes]:
        """The datagrams that have come, at most BATCH of them."""

    def wait(self, timeout: float) -> bool:
        """Wait until there is something to receive, at most `timeout` [s]; whether there is."""

    def close(self) -> None:
        """Release it; the other calls then do nothing."""


class UdpTransport:
    """One UDP socket towards one peer; datagrams from anybody else are counted and dropped.

    The socket is not connected: a peer that refuses, a route that is gone and an interface that
    went down show as failures of single calls, and pass when the cause does.
    """

    def __init__(self, host: str, port: int, bind: int = 0) -> None:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        family, kind, _, _, peer = min(places, key=lambda place: place[0] != socket.AF_INET)
        self.counts: Counter[str] = Counter(strangers=0, send_failures=0, receive_failures=0)
        self._peer = peer
        self._socket = socket.socket(family, kind)
        try:
            self._socket.setblocking(False)
            self._socket.bind(("", bind))
        except OSError:
            self._socket.close()
            raise

    @property
    def port(self) -> int:
        """The local port."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes) -> None:
        """Send a datagram to the peer."""
        try:
            self._socket.sendto(data, self._peer)
        except OSError:
            self.counts["send_failures"] += 1

    def receive(self) -> list[bytes]:
        """The peer's datagrams that have come, each at most one byte longer than a frame."""
        got = []
        for _ in range(BATCH):
            try:
                data, source = self._socket.recvfrom(FRAME_SIZE + 1)
            except BlockingIOError:
                break
            except OSError:
                self.counts["receive_failures"] += 1
                break
            if source[:2] == self._peer[:2]:
                got.append(data)
            else:
                self.counts["strangers"] += 1
        return got

    def wait(self, timeout: float) -> bool:
        """Wait for a datagram."""
        try:
            return bool(select([self._socket], [], [], timeout)[0])
        except (OSError, ValueError):  # closed meanwhile
            return False

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def open_transport(url: str) -> Transport:
    """Open what a URL names: `udp://HOST:PORT?bind=PORT`; bind is the local port, 0 for any.

    Raises:
        TransportError: the URL is not understood, its host is not known, or the port is taken.
    """
    expected = "expected udp://HOST:PORT?bind=PORT"
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
        query = parse_qs(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        bind = int(query.pop("bind", ["0"])[-1])
    except ValueError as error:
        raise TransportError(f"url is {url!r}, {expected}: {error}") from None
    if parts.scheme != "udp" or not host or not port or parts.path or query:
        raise TransportError(f"url is {url!r}, {expected}")
    if not 0 <= bind <= 65535:
        raise TransportError(f"url is {url!r}, {expected}: bind is {bind}, expected 0 to 65535")
    try:
        return UdpTransport(host, port, bind)
    except OSError as error:
        raise TransportError(f"url {url!r} cannot be opened: {error.strerror or error}") from None
