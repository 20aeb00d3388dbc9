"""When frames are due."""

import time
from collections.abc import Callable
from typing import Protocol

from fss_arm_model.units import SECOND
from fss_sim.testbed import FRAME

LEAD = 40  # frames that may pass without a word from a driver that sends five times a second
MIN_REST = 0.005  # real time between two checks [s]: each /clock message wakes every node
STRIDE = 10  # frames made at once at most, so that the node remains responsive
DRIVER_TIMEOUT = 1_000_000_000  # a driver silent for this long of real time has ended [ns]


class Pace(Protocol):
    """How fast time passes in the test bed."""

    epoch: int  # time of frame 0 by the clock that it follows [ns]
    jumps: int  # of that clock
    rest: float  # real time from one check of it to the next [s]

    def due(self, frame: int) -> int:
        """How many frames are due after the last one made."""

    def late(self, frame: int) -> int:
        """Time since the last frame made [ns]."""

    def hear(self, link: int, frame: int) -> None:
        """A link's driver has said something."""


class Clocked:
    """Frames at their rate by some clock [ns]; a late frame is made up for and never skipped.

    Args:
        now: reads the clock.
        frame: the last one made.
        back: a clock that is further behind the last frame was set, not late [ns].
        ahead: one that is further ahead of it was set, too; the pace goes on from the new time.
        speed: of that clock, in multiples of real time.
    """

    def __init__(
        self, now: Callable[[], int], frame: int, back: int, ahead: int, speed: float = 1.0
    ) -> None:
        self.now, self.back, self.ahead = now, back, ahead
        self.rest = max(0.5 * FRAME / SECOND / speed, MIN_REST)
        self.epoch = now() - frame * FRAME  # the clock's time of frame 0
        self.jumps = 0

    def late(self, frame: int) -> int:
        """Time since the frame, by the clock [ns]; from FRAME on, the next one is due."""
        late = self.now() - self.epoch - frame * FRAME
        if -self.back <= late <= self.ahead:
            return late
        self.epoch += late
        self.jumps += 1
        return 0

    def due(self, frame: int) -> int:
        """As many as the clock says."""
        return self.late(frame) // FRAME

    def hear(self, link: int, frame: int) -> None:
        """A clock waits for nobody."""


class FlatOut:
    """As fast as frames can be computed and the links' drivers follow.

    Args:
        now: reads the clock of real time [ns].
    """

    epoch = jumps = 0
    rest = 0.002  # time for other processes: each /clock message wakes every node [s]

    def __init__(self, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.now = now
        self._heard: dict[int, tuple[int, int]] = {}  # last frame and real time [ns], by link

    def due(self, frame: int) -> int:
        """As many as leave no driver behind that is there."""
        now = self.now()
        there = [k for k, t in self._heard.values() if now - t <= DRIVER_TIMEOUT]
        return max(0, min(STRIDE, *(k + LEAD - frame for k in there)) if there else STRIDE)

    def late(self, frame: int) -> int:
        """Nothing happens between frames."""
        return 0

    def hear(self, link: int, frame: int) -> None:
        """Its driver has followed to this frame."""
        self._heard[link] = frame, self.now()
