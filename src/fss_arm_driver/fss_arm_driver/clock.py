"""The link's clock mapped to the host's, by round trips.

One-way delay cannot be told from an offset between clocks, a round trip can: a command sent at s
that the link echoes with turn-around T in telemetry measured at C and received at r bounds

    host - link  in  [s - (C - T), r - C]

an interval as wide as the datagrams' time under way, r - s - T. The narrowest one is kept; it
widens with its age, since the link's oscillator drifts. Integer nanoseconds on the host's side,
the protocol's microseconds on the link's.
"""

from math import inf, nan, sqrt

WIDEST = 1_000_000_000  # round trip worth learning from [ns]
DRIFT = 1e-4  # of the link's oscillator against the host's, at most
MICROSECOND = 1000  # [ns]


class LinkClock:
    """Maps one run of a link's clock to host time.

    Before the first round trip the least delayed frame stands in: its delay is taken as zero,
    and the deviation is infinite.

    Args:
        measured: the link's clock at a measurement [us].
        received: when the host received it [ns].
        resolution: step of the host's clock, as of a simulated one [ns].
    """

    def __init__(self, measured: int, received: int, resolution: int = 0) -> None:
        self.offset = received - measured * MICROSECOND  # host - link [ns]
        self.round_trip = nan  # without the turn-around, of the exchange in use [s]
        self._half_width = inf  # of the interval [ns] ...
        self._since = received  # ... at this time [ns]
        self._resolution = resolution

    def one_way(self, measured: int, received: int) -> None:
        """Learn from a frame that echoes no command known: it came after it was measured."""
        if self._half_width == inf:
            self.offset = min(self.offset, received - measured * MICROSECOND)

    def exchange(self, sent: int, turnaround: int, measured: int, received: int) -> None:
        """Learn from a command sent at `sent` [ns] and its echo, `turnaround` in us.

        An exchange that takes less than no time is none, and is ignored as is one of over 1 s.
        """
        received += self._resolution  # the clock's step before it may have been missed
        earliest = sent - (measured - turnaround) * MICROSECOND
        width = received - measured * MICROSECOND - earliest
        if not 0 <= width <= min(WIDEST, 2.0 * self.half_width(received)):
            return
        self.offset = earliest + width // 2
        self.round_trip = max(0, width - self._resolution) * 1e-9
        self._half_width, self._since = 0.5 * max(width, self._resolution), received

    def half_width(self, now: int) -> float:
        """The offset is known to plus or minus this [ns]."""
        return self._half_width + DRIFT * max(0, now - self._since)

    def deviation(self, now: int) -> float:
        """Standard deviation of a mapped time [s], the offset being anywhere in its interval."""
        return 1e-9 * self.half_width(now) / sqrt(3.0)

    def to_host(self, clock: int) -> int:
        """Host time [ns] of the link's clock [us]."""
        return clock * MICROSECOND + self.offset

    def to_link(self, now: int) -> int:
        """The link's clock [us] at host time [ns]; not negative."""
        return max(0, (now - self.offset) // MICROSECOND)
