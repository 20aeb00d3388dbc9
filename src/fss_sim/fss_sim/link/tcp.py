"""The TCP ports that links listen on."""

import socket
from contextlib import suppress
from typing import Any

from fss_arm_driver.protocol import StreamDecoder, pack

LARGEST = 8192  # bytes read at once of one connection
MOST = 4  # connections; whoever comes later takes the place of one that has sent no frame, or else
# of the oldest, but never of the one that telemetry goes to


class LinkListener:
    """One link's TCP port. Nothing blocks, and nothing raises once it is open.

    Several may be connected; telemetry goes to whose command was taken last, as with datagrams, so
    that one who connects and sends nothing, or nonsense, takes it from nobody. While that one is
    gone it goes to who came last.

    Raises:
        OSError: the port cannot be had; the message says which.
    """

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.setblocking(False)
        self._connections: dict[socket.socket, StreamDecoder] = {}  # the oldest first
        self._peer: socket.socket | None = None
        try:
            self._listener.bind((host, port))
            self._listener.listen(MOST)
        except OSError as error:
            self._listener.close()
            raise OSError(f"TCP port {port} of {host} cannot be opened: {error.strerror}") from None

    @property
    def port(self) -> int:
        """The port it has."""
        return int(self._listener.getsockname()[1])

    @property
    def place(self) -> str:
        """Where a driver finds it."""
        return f"TCP port {self.port}"

    def receive(self) -> list[tuple[bytes, Any]]:
        """The frames that have come, and by which connections."""
        self._accept()
        got: list[tuple[bytes, Any]] = []
        for line, decoder in list(self._connections.items()):
            try:
                if data := line.recv(LARGEST):
                    got += [(frame, line) for frame in decoder.feed(data)]
                else:  # closed by the other end
                    self._drop(line)
            except BlockingIOError:
                pass
            except OSError:
                self._drop(line)
        return got

    def send(self, data: bytes, peer: Any) -> None:
        """Send a frame to the peer, or who is there; what is not read in time is lost."""
        self._peer = peer if peer in self._connections else None
        line = self._peer or next(reversed(self._connections), None)
        if line is None:
            return
        try:
            line.send(pack(data))
        except BlockingIOError:
            pass
        except OSError:
            self._drop(line)

    def reset(self) -> None:
        """Forget what has come; whoever is connected stays so."""
        while self.receive():
            pass
        for line in self._connections:
            self._connections[line] = StreamDecoder()

    def close(self) -> None:
        """Give the port back."""
        for line in list(self._connections):
            self._drop(line)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):  # no more
            while True:
                line, _ = self._listener.accept()
                line.setblocking(False)
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                if len(self._connections) == MOST:
                    others = [one for one in self._connections if one is not self._peer]
                    self._drop(min(others, key=lambda one: self._connections[one].frames > 0))
                self._connections[line] = StreamDecoder()

    def _drop(self, line: socket.socket) -> None:
        self._connections.pop(line, None)
        self._peer = None if line is self._peer else self._peer
        line.close()
