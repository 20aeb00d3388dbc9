"""Threads that process datagrams immediately, within a limited share of the time.

An executor would wake for each datagram and check all entities of a node each time. For four links
in one process that costs more than the rest of the processing of a datagram.

Only one thread of a process runs Python at a time. Telemetry is the only work whose rate this
process does not control; without a limit, commands and stops would have to wait. So the receivers
of a process run one after the other and for at most a SHARE of the time. When it is used up they
rest. After that each processes only the newest frames, and counts the dropped ones.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock, Thread
from time import monotonic, sleep
from typing import Any

from fss_link.transport import BATCH, Transport

SHARE = 0.5  # of the time, for all receivers of a process
AHEAD = 0.1  # by which they may exceed their share in a burst [s]
NEWEST = 16  # frames of a transport that are processed under overload
DRAINED = 64  # most batches read at once, so that a flood cannot block a thread


class Turns:
    """Turns of threads: one at a time, and all together for a share of the time.

    Args:
        share: of the time, above 0 and at most 1.
        ahead: time by which they may exceed it [s].
        clock: the time [s].
    """

    def __init__(self, share: float, ahead: float, clock: Callable[[], float] = monotonic) -> None:
        self._share, self._ahead, self._clock = share, ahead, clock
        self._lock = Lock()
        self._due = 0.0  # when the work up to now would have ended at exactly the share

    def rest(self) -> float:
        """Return how long to rest before the next turn [s]; not positive: it may start."""
        return self._due - self._clock() - self._ahead

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Run the block when no other thread has the turn, and measure its time."""
        with self._lock:
            begun = self._clock()
            yield
            self._due = max(self._due, begun) + (self._clock() - begun) / self._share


TURNS = Turns(SHARE, AHEAD)


class Receiver(Thread):
    """Thread that calls `take` with the received frames, whenever there are any.

    Args:
        transport: source of the frames; its count `dropped` is that of unprocessed frames.
        take: callback for the frames.
        guard: guard condition, triggered if `take` fails; `error` is then the exception.
        turns: turns shared with the other receivers.
    """

    def __init__(
        self,
        transport: Transport,
        take: Callable[[list[bytes]], None],
        guard: Any,
        turns: Turns = TURNS,
    ) -> None:
        super().__init__(daemon=True)
        self.transport, self.take, self.guard, self.turns = transport, take, guard, turns
        self.error: Exception | None = None
        self._closing = False
        transport.counts["dropped"] += 0
        self.start()

    def run(self) -> None:
        """Wait for frames and process them, until closed."""
        try:
            while not self._closing:
                if not self.transport.wait(0.2):
                    continue
                if behind := (rest := self.turns.rest()) > 0.0:
                    sleep(rest)
                with self.turns.turn():
                    self.take(self._newest() if behind else self.transport.receive())
        except Exception as error:
            self.error = error
            self.guard.trigger()

    def _newest(self) -> list[bytes]:
        """Return the newest of the received frames, and count the others as dropped."""
        newest: deque[bytes] = deque(maxlen=NEWEST)
        for _ in range(DRAINED):
            got = self.transport.receive()
            self.transport.counts["dropped"] += max(0, len(newest) + len(got) - NEWEST)
            newest.extend(got)
            if len(got) < BATCH:
                break
        return list(newest)

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        self.join()
