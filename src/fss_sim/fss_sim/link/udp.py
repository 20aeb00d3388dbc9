"""The datagram sockets that links listen on."""

import socket
from contextlib import suppress
from typing import Any

BATCH = 64  # datagrams read at once, so that a flood cannot keep the test bed from its work
LARGEST = 2048  # [bytes] read of one; a longer one is no frame either way


class LinkSocket:
    """One link's UDP port. Nothing blocks, and nothing raises once it is open.

    Raises:
        OSError: the port cannot be had; the message says which.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise OSError(f"UDP port {port} of {host} cannot be opened: {error.strerror}") from None

    @property
    def port(self) -> int:
        """The port it has."""
        return int(self._socket.getsockname()[1])

    @property
    def place(self) -> str:
        """Where a driver finds it."""
        return f"port {self.port}"

    def receive(self) -> list[tuple[bytes, Any]]:
        """The datagrams that have come and their senders, at most BATCH."""
        got = []
        try:
            for _ in range(BATCH):
                got.append(self._socket.recvfrom(LARGEST))
        except OSError:  # no more, or the network's complaint about a datagram sent before
            pass
        return got

    def send(self, data: bytes, peer: Any) -> None:
        """Send a datagram to the peer, if there is one; one that cannot be sent is lost."""
        if peer is not None:
            with suppress(OSError):
                self._socket.sendto(data, peer)

    def reset(self) -> None:
        """Forget what has come."""
        while self.receive():
            pass

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()
