"""Reception of the inputs of a prediction: which of them are silent."""

from collections.abc import Iterable
from math import inf

TIMEOUT = 2.0  # silence after which an input is missing [s]


class InputMonitor:
    """Times at which inputs were last received, by name, in one monotonic clock [s]."""

    def __init__(self) -> None:
        self._received: dict[str, float] = {}

    def add(self, name: str, now: float) -> None:
        """Note that an input was received."""
        self._received[name] = now

    def describe_missing(self, names: Iterable[str], now: float) -> str:
        """Name the inputs that are silent; empty: none."""
        missing = [name for name in names if self._received.get(name, -inf) < now - TIMEOUT]
        return f"nothing received from {', '.join(missing)}" if missing else ""
