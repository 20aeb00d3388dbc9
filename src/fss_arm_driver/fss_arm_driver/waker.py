"""From a transport to an executor: datagrams are taken the moment they come, without polling."""

from threading import Event, Thread
from typing import Any

from fss_arm_driver.transport import Transport


class Waker(Thread):
    """Triggers a guard condition when datagrams have come, once until they are taken."""

    def __init__(self, transport: Transport, guard: Any) -> None:
        super().__init__(daemon=True)
        self.transport, self.guard = transport, guard
        self.closing, self._taken = False, Event()
        self.start()

    def run(self) -> None:
        """Wait, wake, wait until taken."""
        while not self.closing:
            if self.transport.wait(0.2):
                self._taken.clear()
                self.guard.trigger()
                while not (self._taken.wait(0.2) or self.closing):
                    pass

    def taken(self) -> None:
        """Wake again for whatever comes from now on."""
        self._taken.set()

    def close(self) -> None:
        """End the thread."""
        self.closing = True
        self.join()
