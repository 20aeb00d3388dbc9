"""The computer's clocks: one that nobody sets, to time by, and the time of day, to stamp with."""

import time
from collections.abc import Callable


def boot_time() -> int:
    """Time since the computer started, also what it slept [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class HostClock:
    """Times everything by `now`, which is never set, and converts to the time of day and back.

    Args:
        now: the clock to time by [ns].
        day: the time of day [ns]; it may be set at any time. The same as `now` under simulated
            time.
    """

    def __init__(
        self, now: Callable[[], int] = boot_time, day: Callable[[], int] = time.time_ns
    ) -> None:
        self.now, self._day = now, day
        self._ahead = 0

    @property
    def ahead(self) -> int:
        """What to add to `now` to have the time of day [ns].

        Known to the time that the reading takes; within that it stays as it was, so that stamps
        do not jitter by it.
        """
        before, day, after = self.now(), self._day(), self.now()
        self._ahead = max(day - after, min(self._ahead, day - before))
        return self._ahead
