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
NODE_LEAD = 10  # largest number of frames ahead of a node, which reports every 5 frames
NODE_TIMEOUT = 10_000_000_000  # real time after which a silent node is not waited for any more [ns]


class Pace(Protocol):
    """Interface of a pace: it determines the number of frames that are due."""

    epoch: int  # time of frame 0 by the clock that it follows [ns]
    jumps: int  # number of jumps of that clock
    check_period: float  # real time between two checks of that clock [s]

    def due_frames(self, frame: int) -> int:
        """Return the number of frames that are due after the last simulated one."""

    def lag(self, frame: int) -> int:
        """Return the time since the last simulated frame [ns]."""


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


class FullSpeedPace:
    """Pace as fast as frames can be computed."""

    epoch = jumps = 0
    check_period = 0.002  # time for other processes: each /clock message wakes every node [s]

    def due_frames(self, frame: int) -> int:
        """Return a constant number of frames."""
        return MAX_STRIDE

    def lag(self, frame: int) -> int:
        """Return 0: no time passes between frames."""
        return 0


class Followers:
    """Programs that a simulation may only be ahead of by some frames."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[int, int]] = {}  # frame to wait at and when to give up, by name

    def record(self, name: str, frame: int, lead: int, timeout: int) -> None:
        """Record that a program has reached a frame; it is active for `timeout` ns from now."""
        self._last[name] = frame + lead, time.monotonic_ns() + timeout

    def slowest(self) -> tuple[str, int | None]:
        """Return the active program that is furthest behind, and the frame to wait for it at.

        Returns:
            Its name ("" if no program is active), and the frame (None).
        """
        now = time.monotonic_ns()
        active = [(last, name) for name, (last, end) in self._last.items() if now <= end]
        last, name = min(active, default=(None, ""))
        return name, last

    def keep(self, names: set[str]) -> None:
        """Forget all programs but these."""
        self._last = {name: last for name, last in self._last.items() if name in names}
