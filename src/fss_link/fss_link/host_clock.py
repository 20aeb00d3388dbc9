"""Clocks of the computer: a monotonic one for timing, and the time of day for stamps."""

import time
from collections.abc import Callable


def boot_time() -> int:
    """Return the time since the computer started, including sleep [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class HostClock:
    """Clock `now`, which is never set, with its offset to the time of day.

    Args:
        now: the clock used for timing [ns].
        day: the time of day [ns]; it may be set at any time. The same as `now` under simulated
            time.
    """

    def __init__(
        self, now: Callable[[], int] = boot_time, day: Callable[[], int] = time.time_ns
    ) -> None:
        self.now, self._day = now, day
        self._offset = 0

    @property
    def offset(self) -> int:
        """Time of day minus `now` [ns].

        Its uncertainty is the time that the reading takes. Within that the value is kept, so
        that stamps do not jitter.
        """
        before, day, after = self.now(), self._day(), self.now()
        self._offset = max(day - after, min(self._offset, day - before))
        return self._offset
