"""A thread that keeps time, whatever the executor is busy with."""

from collections.abc import Callable
from threading import Event, Thread
from typing import Any


class Ticker(Thread):
    """Calls `tick` again and again, and waits in between as long as that says [s].

    Args:
        tick: what to do.
        guard: a guard condition, triggered if `tick` fails; `error` then says how.
    """

    def __init__(self, tick: Callable[[], float], guard: Any) -> None:
        super().__init__(daemon=True)
        self.tick, self.guard = tick, guard
        self.error: Exception | None = None
        self._closing = Event()
        self.start()

    def run(self) -> None:
        """Tick until closed."""
        try:
            while not self._closing.wait(self.tick()):
                pass
        except Exception as error:
            self.error = error
            self.guard.trigger()

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self.join()
