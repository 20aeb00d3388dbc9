"""Pace of the simulation: the times at which frames are due."""

import time
from collections.abc import Callable
from typing import Protocol

from fss_arm_model.units import SECOND
from fss_sim.testbed import FRAME

LEAD = 40  # largest number of frames without a datagram of a driver, which sends at 5 Hz
MIN_REST = 0.005  # real time between two checks [s]: each /clock message wakes every node
STRIDE = 10  # largest number of frames per check, so that the node remains responsive
DRIVER_TIMEOUT = 1_000_000_000  # real time after which a silent driver has stopped [ns]


class Pace(Protocol):
    """Interface of a pace: it determines the number of frames that are due."""

    epoch: int  # time of frame 0 by the clock that it follows [ns]
    jumps: int  # number of jumps of that clock
    rest: float  # real time between two checks of that clock [s]

    def due(self, frame: int) -> int:
        """Return the number of frames that are due after the last simulated one."""

    def late(self, frame: int) -> int:
        """Return the time since the last simulated frame [ns]."""

    def hear(self, link: int, frame: int) -> None:
        """Record that a datagram of a link's driver was received."""


class Clocked:
    """Pace that follows a clock [ns]; late frames are simulated later, never skipped.

    Args:
        now: reads the clock.
        frame: last simulated frame.
        back: a clock further behind the last frame than this has jumped [ns].
        ahead: a clock further ahead of it has jumped, too; the pace resumes at the new time [ns].
        speed: speed of that clock, in multiples of real time.
    """

    def __init__(
        self, now: Callable[[], int], frame: int, back: int, ahead: int, speed: float = 1.0
    ) -> None:
        self.now, self.back, self.ahead = now, back, ahead
        self.rest = max(0.5 * FRAME / SECOND / speed, MIN_REST)
        self.epoch = now() - frame * FRAME  # the clock's time of frame 0
        self.jumps = 0

    def late(self, frame: int) -> int:
        """Return the time since the frame, by the clock [ns]; from FRAME on, the next is due.

        If the clock has jumped, count the jump, resume at its new time and return 0.
        """
        late = self.now() - self.epoch - frame * FRAME
        if -self.back <= late <= self.ahead:
            return late
        self.epoch += late
        self.jumps += 1
        return 0

    def due(self, frame: int) -> int:
        """Return the number of frames that are due by the clock."""
        return self.late(frame) // FRAME

    def hear(self, link: int, frame: int) -> None:
        """Do nothing: this pace does not depend on the drivers."""


class FlatOut:
    """Pace as fast as frames can be computed and the links' drivers can follow.

    Args:
        now: reads the clock of real time [ns].
    """

    epoch = jumps = 0
    rest = 0.002  # time for other processes: each /clock message wakes every node [s]

    def __init__(self, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.now = now
        self._heard: dict[int, tuple[int, int]] = {}  # last frame and real time [ns], by link

    def due(self, frame: int) -> int:
        """Return the number of frames by which no active driver falls too far behind."""
        now = self.now()
        there = [k for k, t in self._heard.values() if now - t <= DRIVER_TIMEOUT]
        return max(0, min(STRIDE, *(k + LEAD - frame for k in there)) if there else STRIDE)

    def late(self, frame: int) -> int:
        """Return 0: no time passes between frames."""
        return 0

    def hear(self, link: int, frame: int) -> None:
        """Record that the link's driver has followed up to this frame."""
        self._heard[link] = frame, self.now()
