"""A thread that takes datagrams the moment they come.

An executor would be woken for each, and asks all of a node's entities what they have every time it
is: for four links in one process that costs more than all else that a datagram needs.
"""

from collections.abc import Callable
from threading import Thread
from typing import Any

from fss_arm_driver.transport import Transport


class Receiver(Thread):
    """Calls `take` whenever there is something to receive.

    Args:
        transport: where from.
        take: what to do.
        guard: a guard condition, triggered if `take` fails; `error` then says how.
    """

    def __init__(self, transport: Transport, take: Callable[[], None], guard: Any) -> None:
        super().__init__(daemon=True)
        self.transport, self.take, self.guard = transport, take, guard
        self.error: Exception | None = None
        self._closing = False
        self.start()

    def run(self) -> None:
        """Wait and take, until closed."""
        try:
            while not self._closing:
                if self.transport.wait(0.2):
                    self.take()
        except Exception as error:
            self.error = error
            self.guard.trigger()

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        self.join()
