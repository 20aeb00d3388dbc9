"""Threads that process datagrams immediately, within a limited share of the time.

An executor would wake for each datagram and check all entities of a node each time. For four links
in one process that costs more than the rest of the processing of a datagram.

Only one thread of a process runs Python at a time. Telemetry is the only work whose rate this
process does not control; without a limit, commands and stops would have to wait. So the receivers
of a process run one after the other and for at most CPU_SHARE of the time. When it is used up they
rest. After that each asks its node to shed telemetry, and processes only the newest frames; both
are counted. A paused process has not used its share: it processes all that was buffered.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock, Thread
from time import monotonic, sleep
from typing import Any

from fss_link.transport import BATCH, Transport

CPU_SHARE = 0.5  # of the time, for all receivers of a process
MAX_BURST = 0.1  # by which they may exceed their share in a burst [s]
OVERLOAD_FRAMES = 16  # frames of a transport that are processed under overload
MAX_BATCHES = 64  # most batches read at once, so that a flood cannot block a thread


class TurnScheduler:
    """Turns of threads: one at a time, and all together for a share of the time.

    Args:
        share: of the time, above 0 and at most 1.
        burst: time by which they may exceed it [s].
        clock: the time [s].
    """

    def __init__(self, share: float, burst: float, clock: Callable[[], float] = monotonic) -> None:
        self._share, self._burst, self._clock = share, burst, clock
        self._lock = Lock()
        self._due = 0.0  # when the work up to now would have ended at exactly the share

    def wait_time(self) -> float:
        """Return how long to rest before the next turn [s]; not positive: it may start."""
        return self._due - self._clock() - self._burst

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Run the block when no other thread has the turn, and measure its time."""
        with self._lock:
            start = self._clock()
            yield
            self._due = max(self._due, start) + (self._clock() - start) / self._share


SCHEDULER = TurnScheduler(CPU_SHARE, MAX_BURST)


class Receiver(Thread):
    """Thread that calls `callback` with the received frames, whenever there are any.

    Args:
        transport: source of the frames; its count `dropped` is that of unprocessed frames.
        callback: for the frames, and True if the threads' share of the time is used up.
        guard_condition: triggered if `callback` fails; `error` is then the exception.
        scheduler: turns shared with the other receivers.
    """

    def __init__(
        self,
        transport: Transport,
        callback: Callable[[list[bytes], bool], None],
        guard_condition: Any,
        scheduler: TurnScheduler = SCHEDULER,
    ) -> None:
        super().__init__(daemon=True)
        self.transport, self.callback = transport, callback
        self.guard_condition, self.scheduler = guard_condition, scheduler
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
                if overloaded := (pause := self.scheduler.wait_time()) > 0.0:
                    sleep(pause)
                with self.scheduler.turn():
                    receive = self._receive_newest if overloaded else self.transport.receive
                    self.callback(receive(), overloaded)
        except Exception as error:
            self.error = error
            self.guard_condition.trigger()

    def _receive_newest(self) -> list[bytes]:
        """Return the newest of the received frames, and count the others as dropped."""
        newest: deque[bytes] = deque(maxlen=OVERLOAD_FRAMES)
        for _ in range(MAX_BATCHES):
            received = self.transport.receive()
            excess = len(newest) + len(received) - OVERLOAD_FRAMES
            self.transport.counts["dropped"] += max(0, excess)
            newest.extend(received)
            if len(received) < BATCH:
                break
        return list(newest)

    def close(self) -> None:
        """Stop the thread."""
        self._closing = True
        self.join()
