"""Frames as datagrams."""

import socket
from collections import Counter

from fss_arm_driver.protocol import FRAME_SIZE
from fss_arm_driver.transport.base import BATCH, readable

HELD = 1024  # frames that the system holds while nobody reads: 2 s of a link's at 500 Hz
SKB = 768  # that Linux counts for a frame [bytes]; it grants twice what it is asked for


class UdpTransport:
    """One UDP socket towards one peer; datagrams from anybody else are counted and dropped.

    The socket is not connected: a peer that refuses, a route that is gone and an interface that
    went down show as failures of single calls, and pass when the cause does. It holds as many
    frames as HELD, or as the system's net.core.rmem_max allows.

    Raises:
        OSError: the host is not known, or the local port is taken.
    """

    def __init__(self, host: str, port: int, bind: int = 0) -> None:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        family, kind, _, _, peer = min(places, key=lambda place: place[0] != socket.AF_INET)
        self.counts: Counter[str] = Counter(strangers=0, send_failures=0, receive_failures=0)
        self.trouble = ""
        self._peer = peer
        self._socket = socket.socket(family, kind)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, HELD * SKB // 2)
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
        except OSError as error:
            self.counts["send_failures"] += 1
            self.trouble = f"nothing can be sent: {error.strerror or error}"
        else:
            self.trouble = ""

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
            return bool(readable([self._socket], timeout))
        except (OSError, ValueError):  # closed meanwhile
            return False

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
