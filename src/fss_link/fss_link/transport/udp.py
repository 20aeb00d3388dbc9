"""Frames as datagrams."""

import socket
from collections import Counter

from fss_link.protocol import FRAME_SIZE
from fss_link.transport.base import BATCH, readable

BUFFERED_FRAMES = 1024  # frames that the system buffers: 2 s of a link's at 500 Hz
BUFFER_PER_FRAME = 768  # buffer space per frame in Linux [bytes]; it grants twice the request


class UdpTransport:
    """UDP socket for one peer; datagrams from other senders are counted and dropped.

    The socket is not connected. A peer that refuses, a missing route or an interface that is down
    makes single calls fail, only as long as the cause persists. The socket buffers
    BUFFERED_FRAMES frames, or fewer if the system's net.core.rmem_max limits them.

    Raises:
        OSError: the host is not known, or the local port is taken.
    """

    def __init__(self, host: str, port: int, bind: int = 0) -> None:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        family, kind, _, _, peer = min(places, key=lambda place: place[0] != socket.AF_INET)
        self.counts: Counter[str] = Counter(other_senders=0, send_failures=0, receive_failures=0)
        self.problem = ""
        self._peer = peer
        self._socket = socket.socket(family, kind)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(
                socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFERED_FRAMES * BUFFER_PER_FRAME // 2
            )
            self._socket.bind(("", bind))
        except OSError:
            self._socket.close()
            raise

    @property
    def port(self) -> int:
        """Local port."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes) -> None:
        """Send a datagram to the peer."""
        try:
            self._socket.sendto(data, self._peer)
        except OSError as error:
            self.counts["send_failures"] += 1
            self.problem = f"cannot send: {error.strerror or error}"
        else:
            self.problem = ""

    def receive(self) -> list[bytes]:
        """Return the peer's received datagrams, each cut to one byte more than a frame."""
        received = []
        for _ in range(BATCH):
            try:
                data, source = self._socket.recvfrom(FRAME_SIZE + 1)
            except BlockingIOError:
                break
            except OSError:
                self.counts["receive_failures"] += 1
                break
            if source[:2] == self._peer[:2]:
                received.append(data)
            else:
                self.counts["other_senders"] += 1
        return received

    def wait(self, timeout: float) -> bool:
        """Wait for a datagram."""
        try:
            return bool(readable([self._socket], timeout))
        except (OSError, ValueError):  # closed meanwhile
            return False

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
