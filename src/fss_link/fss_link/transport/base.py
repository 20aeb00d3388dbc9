"""Common interface of all transports to a link."""

from collections import Counter
from collections.abc import Sequence
from select import POLLIN, poll
from typing import Protocol

BATCH = 64  # most frames read at once, so that a flood cannot block a node


class TransportError(ValueError):
    """Error of a URL that is not valid, or that cannot be opened."""


class Line(Protocol):
    """Open source of bytes: a socket or a serial port."""

    def fileno(self) -> int:
        """Return its file descriptor, which is non-blocking."""

    def close(self) -> None:
        """Close it."""


def readable(lines: Sequence[Line], timeout: float) -> list[Line]:
    """Wait up to `timeout` [s] and return those of `lines` that have bytes or were closed.

    Unlike `select` this works with file descriptors above 1023.

    Raises:
        ValueError: one of them is closed.
    """
    poller = poll()
    for line in lines:
        poller.register(line, POLLIN)
    ready = {number for number, _ in poller.poll(1000.0 * timeout)}
    return [line for line in lines if line.fileno() in ready]


class Transport(Protocol):
    """Transport of frames to and from one link. Only `wait` blocks; nothing raises once open.

    `wait` is called by a separate thread, and reopens a lost connection. `problem` describes what
    is wrong with the connection; it is empty if none is known.
    """

    counts: Counter[str]
    problem: str

    def send(self, data: bytes) -> None:
        """Send a frame; one that cannot be sent is counted and dropped."""

    def receive(self) -> list[bytes]:
        """Return the received data, about BATCH frames at most; it may be invalid."""

    def wait(self, timeout: float) -> bool:
        """Wait about `timeout` [s] for data; return True if there is any to receive."""

    def close(self) -> None:
        """Release it, when no thread waits; after that the other calls do nothing."""
