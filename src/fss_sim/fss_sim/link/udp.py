"""UDP ports on which links listen."""

import socket
from contextlib import suppress
from typing import Any

BATCH = 64  # maximum number of datagrams per read, so that a flood cannot block the test bed
MAX_READ_SIZE = 2048  # bytes read of one datagram; a longer one is not a valid frame anyway


class LinkSocket:
    """UDP port of one link; no method blocks, or raises after it is opened.

    Raises:
        OSError: if the port is not available; the message names it.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise OSError(
                f"UDP port {port} of {host} cannot be opened: {error.strerror}; another test bed "
                "runs, or choose other ports"
            ) from None

    @property
    def port(self) -> int:
        """Port number."""
        return int(self._socket.getsockname()[1])

    @property
    def address(self) -> str:
        """Description of the port, for diagnostics."""
        return f"port {self.port}"

    def receive(self) -> list[tuple[bytes, Any]]:
        """Return the received datagrams and their senders, at most BATCH."""
        got = []
        try:
            for _ in range(BATCH):
                got.append(self._socket.recvfrom(MAX_READ_SIZE))
        except OSError:  # no datagram left, or an error caused by a datagram sent earlier
            pass
        return got

    def send(self, data: bytes, peer: Any) -> None:
        """Send a datagram to the peer, if there is one; one that cannot be sent is lost."""
        if peer is not None:
            with suppress(OSError):
                self._socket.sendto(data, peer)

    def reset(self) -> None:
        """Discard all datagrams not yet read."""
        while self.receive():
            pass

    def close(self) -> None:
        """Close the port."""
        self._socket.close()
