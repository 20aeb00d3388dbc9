"""What the driver knows of the way to a link."""

from collections import Counter
from typing import Protocol

BATCH = 64  # frames read at once, so that a flood cannot keep a node from its other work


class TransportError(ValueError):
    """A URL that names no transport, or one that cannot be opened."""


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
