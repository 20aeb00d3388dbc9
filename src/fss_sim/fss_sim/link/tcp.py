"""TCP ports on which links listen."""

import socket
from contextlib import suppress
from typing import Any

from fss_link.protocol import StreamDecoder, pack

MAX_READ_SIZE = 8192  # maximum number of bytes per read of one connection
# Maximum number of connections. A further connection replaces one that has sent no frame, or else
# the oldest, but never the one that receives telemetry.
MAX_CONNECTIONS = 4


class LinkListener:
    """TCP port of one link; no method blocks, or raises after it is opened.

    Several clients can be connected. As with datagrams, telemetry is sent to the client whose
    command was accepted last, so that a client that sends no valid command does not receive it
    instead. If this client has disconnected, telemetry is sent to the newest connection.

    Raises:
        OSError: if the port is not available; the message names it.
    """

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.setblocking(False)
        self._connections: dict[socket.socket, StreamDecoder] = {}  # the oldest first
        self._peer: socket.socket | None = None
        try:
            self._listener.bind((host, port))
            self._listener.listen(MAX_CONNECTIONS)
        except OSError as error:
            self._listener.close()
            raise OSError(
                f"TCP port {port} of {host} cannot be opened: {error.strerror}; another test bed "
                "runs, or choose other ports"
            ) from None

    @property
    def port(self) -> int:
        """Port number."""
        return int(self._listener.getsockname()[1])

    @property
    def address(self) -> str:
        """Description of the port, for diagnostics."""
        return f"TCP port {self.port}"

    def receive(self) -> list[tuple[bytes, Any]]:
        """Return the received frames, each with its connection."""
        self._accept()
        got: list[tuple[bytes, Any]] = []
        for line, decoder in list(self._connections.items()):
            try:
                if data := line.recv(MAX_READ_SIZE):
                    got += [(frame, line) for frame in decoder.feed(data)]
                else:  # closed by the other end
                    self._drop(line)
            except BlockingIOError:
                pass
            except OSError:
                self._drop(line)
        return got

    def send(self, data: bytes, peer: Any) -> None:
        """Send a frame to the peer, else to the newest connection; lost if the buffer is full."""
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
        """Discard all data not yet read; connections stay open."""
        while self.receive():
            pass
        for line in self._connections:
            self._connections[line] = StreamDecoder()

    def close(self) -> None:
        """Close all connections and the port."""
        for line in list(self._connections):
            self._drop(line)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):  # no connection left to accept
            while True:
                line, _ = self._listener.accept()
                line.setblocking(False)
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                if len(self._connections) == MAX_CONNECTIONS:
                    others = [one for one in self._connections if one is not self._peer]
                    self._drop(min(others, key=lambda one: self._connections[one].frames > 0))
                self._connections[line] = StreamDecoder()

    def _drop(self, line: socket.socket) -> None:
        self._connections.pop(line, None)
        self._peer = None if line is self._peer else self._peer
        line.close()
