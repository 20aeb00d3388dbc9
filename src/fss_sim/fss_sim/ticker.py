"""Thread that advances the simulation independently of the executor."""

from collections.abc import Callable
from threading import Event, Thread
from typing import Any


class Ticker(Thread):
    """Thread that calls `tick` repeatedly, and then waits for the time that it returns [s].

    Args:
        tick: function to call.
        guard: guard condition that is triggered if `tick` raises; `error` is then the exception.
    """

    def __init__(self, tick: Callable[[], float], guard: Any) -> None:
        super().__init__(daemon=True)
        self.tick, self.guard = tick, guard
        self.error: Exception | None = None
        self._closing = Event()
        self.start()

    def run(self) -> None:
        """Call `tick` until the thread is closed."""
        try:
            while not self._closing.wait(self.tick()):
                pass
        except Exception as error:
            self.error = error
            self.guard.trigger()

    def close(self) -> None:
        """Stop the thread."""
        self._closing.set()
        self.join()
