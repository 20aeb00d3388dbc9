"""What all ways to a link have in common."""

from collections import Counter
from collections.abc import Sequence
from select import POLLIN, poll
from typing import Protocol

BATCH = 64  # frames read at once, so that a flood cannot keep a node from its other work


class TransportError(ValueError):
    """A URL that names no transport, or one that cannot be opened."""


class Line(Protocol):
    """Something open that bytes come from: a socket, a serial port."""

    def fileno(self) -> int:
        """Its file descriptor, which does not block."""

    def close(self) -> None:
        """Close it."""


def readable(lines: Sequence[Line], timeout: float) -> list[Line]:
    """Those of `lines` that have bytes or have ended; waits for one until `timeout` [s].

    Unlike `select`, of any file descriptor: a process may have more than a thousand.

    Raises:
        ValueError: one of them is closed.
    """
    poller = poll()
    for line in lines:
        poller.register(line, POLLIN)
    ready = {number for number, _ in poller.poll(1000.0 * timeout)}
    return [line for line in lines if line.fileno() in ready]


class Transport(Protocol):
    """Frames to and from one link. Nothing but `wait` blocks, and nothing raises once open.

    `wait` is for a thread of its own; what was lost on the way is opened again by it. `trouble`
    says in words what is wrong with the way, and is empty if nothing is known to be.
    """

    counts: Counter[str]
    trouble: str

    def send(self, data: bytes) -> None:
        """Send a frame; what cannot be sent is counted and dropped."""

    def receive(self) -> list[bytes]:
        """What has come, about BATCH frames at most; it need not be frames."""

    def wait(self, timeout: float) -> bool:
        """Wait until there is something to receive, about `timeout` [s]; whether there is."""

    def close(self) -> None:
        """Release it, once nobody waits; the other calls then do nothing."""
