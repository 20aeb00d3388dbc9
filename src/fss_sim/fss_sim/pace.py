"""Pace of the simulation: the times at which frames are due."""

import time
from collections.abc import Callable
from typing import Protocol

from fss_arm_model.units import SECOND
from fss_sim.testbed import FRAME

MAX_LEAD = 40  # largest number of frames without a datagram of a driver, which sends at 5 Hz
MIN_CHECK_PERIOD = 0.005  # real time between two checks [s]: each /clock message wakes every node
MAX_STRIDE = 10  # largest number of frames per check, so that the node remains responsive
DRIVER_TIMEOUT = 1_000_000_000  # real time after which a silent driver has stopped [ns]


class Pace(Protocol):
    """Interface of a pace: it determines the number of frames that are due."""

    epoch: int  # time of frame 0 by the clock that it follows [ns]
    jumps: int  # number of jumps of that clock
    check_period: float  # real time between two checks of that clock [s]

    def due_frames(self, frame: int) -> int:
        """Return the number of frames that are due after the last simulated one."""

    def lag(self, frame: int) -> int:
        """Return the time since the last simulated frame [ns]."""

    def record_datagram(self, link: int, frame: int) -> None:
        """Record that a datagram of a link's driver was received."""


class ClockPace:
    """Pace that follows a clock [ns]; late frames are simulated later, never skipped.

    Args:
        now: reads the clock.
        frame: last simulated frame.
        max_behind: a clock further behind the last frame than this has jumped [ns].
        max_ahead: a clock further ahead has jumped, too; the pace resumes at the new time [ns].
        speed: speed of that clock, in multiples of real time.
    """

    def __init__(
        self,
        now: Callable[[], int],
        frame: int,
        max_behind: int,
        max_ahead: int,
        speed: float = 1.0,
    ) -> None:
        self.now, self.max_behind, self.max_ahead = now, max_behind, max_ahead
        self.check_period = max(0.5 * FRAME / SECOND / speed, MIN_CHECK_PERIOD)
        self.epoch = now() - frame * FRAME  # the clock's time of frame 0
        self.jumps = 0

    def lag(self, frame: int) -> int:
        """Return the time since the frame, by the clock [ns]; from FRAME on, the next is due.

        If the clock has jumped, count the jump, resume at its new time and return 0.
        """
        lag = self.now() - self.epoch - frame * FRAME
        if -self.max_behind <= lag <= self.max_ahead:
            return lag
        self.epoch += lag
        self.jumps += 1
        return 0

    def due_frames(self, frame: int) -> int:
        """Return the number of frames that are due by the clock."""
        return self.lag(frame) // FRAME

    def record_datagram(self, link: int, frame: int) -> None:
        """Do nothing: this pace does not depend on the drivers."""


class FullSpeedPace:
    """Pace as fast as frames can be computed and the links' drivers can follow.

    Args:
        now: reads the clock of real time [ns].
    """

    epoch = jumps = 0
    check_period = 0.002  # time for other processes: each /clock message wakes every node [s]

    def __init__(self, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.now = now
        self._followed: dict[int, tuple[int, int]] = {}  # last frame and real time [ns], by link

    def due_frames(self, frame: int) -> int:
        """Return the number of frames by which no active driver falls too far behind."""
        now = self.now()
        followed = [k for k, t in self._followed.values() if now - t <= DRIVER_TIMEOUT]
        return max(0, min([MAX_STRIDE, *(k + MAX_LEAD - frame for k in followed)]))

    def lag(self, frame: int) -> int:
        """Return 0: no time passes between frames."""
        return 0

    def record_datagram(self, link: int, frame: int) -> None:
        """Record that the link's driver has followed up to this frame."""
        self._followed[link] = frame, self.now()
