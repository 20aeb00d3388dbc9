"""Threads that take datagrams the moment they come, as long as that leaves time for all else.

An executor would be woken for each, and asks all of a node's entities what they have every time it
is: for four links in one process that costs more than all else that a datagram needs.

One thread of a process runs Python at a time, whoever waits. Telemetry is the only work that comes
at a rate which nobody here decides; if all of it were taken, commands and a stop would queue behind
it. So the receivers of a process work one after the other and for at most a SHARE of the time. When
that is used up they rest; of what came meanwhile each takes the newest frames, and counts the rest.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock, Thread
from time import monotonic, sleep
from typing import Any

from fss_arm_driver.transport import BATCH, Transport

SHARE = 0.5  # of the time, for all receivers of a process
AHEAD = 0.1  # that they may be ahead of their share, for what comes in a burst [s]
NEWEST = 16  # frames of a transport that are taken when there is too much
DRAINED = 64  # batches thrown away at most at once, so that a flood cannot keep a thread


class Turns:
    """One at a time, and all together for a share of the time.

    Args:
        share: of the time, above 0 and at most 1.
        ahead: how far they may be ahead of it [s].
        clock: the time [s].
    """

    def __init__(self, share: float, ahead: float, clock: Callable[[], float] = monotonic) -> None:
        self._share, self._ahead, self._clock = share, ahead, clock
        self._lock = Lock()
        self._due = 0.0  # by when what was taken so far would have been, at the share

    def rest(self) -> float:
        """How long to rest before the next turn [s]; not positive: it may begin."""
        return self._due - self._clock() - self._ahead

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Work, when nobody else does."""
        with self._lock:
            begun = self._clock()
            yield
            self._due = max(self._due, begun) + (self._clock() - begun) / self._share


TURNS = Turns(SHARE, AHEAD)


class Receiver(Thread):
    """Calls `take` with the frames that have come, whenever some have.

    Args:
        transport: where from; its count `dropped` is of frames that there was no time for.
        take: what to do.
        guard: a guard condition, triggered if `take` fails; `error` then says how.
        turns: whose turn it is.
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
        """Wait and take, until closed."""
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
        """The newest frames of all that have come."""
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
