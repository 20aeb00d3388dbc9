"""The link's clock mapped to the host's, by round trips.

One-way delay looks like an offset between clocks, a round trip does not: a command sent at s
that the link echoes with turn-around T in telemetry measured at C and received at r bounds

    host - link  in  [s - (C - T), r - C]

an interval as wide as the datagrams' time under way, w = r - s - T. Its middle is off by half the
difference of the two ways' delays, so little when w is little above the least possible one. The
offset is a line over time, as the link's oscillator drifts,

    host - link = o + d (C - C_0),    d ~ N(0, DRIFT^2)

fitted to the middles of the narrowest interval of each few seconds by weighted least squares: each
deviates by half of what its interval is wider than the narrowest one, over sqrt(3). The line must
pass through that one. Integer nanoseconds on the host's side, the protocol's microseconds on the
link's.
"""

from collections import deque
from dataclasses import dataclass
from math import inf, nan, sqrt
from statistics import median_low

MICROSECOND, SECOND = 1000, 1_000_000_000  # [ns]
MAX_ROUND_TRIP = SECOND  # of an exchange worth learning from
DRIFT = 1e-4 / sqrt(3.0)  # of a link's oscillator against the host's, 1 sigma
SLOT = 1_000_000  # of which the narrowest interval is kept [us]
SLOTS = 300  # kept: how far a drift is taken as constant
JITTER = 20_000.0  # of reading clocks, 1 sigma [ns]


@dataclass(frozen=True, slots=True)
class _Exchange:
    """One round trip."""

    measured: int  # [us]
    middle: int  # of the interval that the offset lies in [ns]
    width: int  # of it [ns]


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
        self.drift = 0.0
        self.round_trip = nan  # without the turn-around, of the narrowest exchange kept [s]
        self._offset = received - measured * MICROSECOND  # host - link at _origin [ns]
        self._origin = measured  # [us]
        self._kept: deque[_Exchange] = deque(maxlen=SLOTS)
        self._half_width = inf  # of the narrowest interval kept [ns]
        self._drift_deviation = DRIFT
        self._resolution = resolution

    def one_way(self, measured: int, received: int) -> None:
        """Learn from a frame that echoes no command known: it came after it was measured."""
        if not self._kept:
            self._offset = min(self._offset, received - measured * MICROSECOND)

    def exchange(self, sent: int, turnaround: int, measured: int, received: int) -> None:
        """Learn from a command sent at `sent` [ns] and its echo, `turnaround` in us.

        An exchange that takes less than no time is none, and is ignored as is one of over 1 s.
        One that leaves no room for what is known means that a clock was set: all begins anew.
        """
        received += self._resolution  # the clock's step before it may have been missed
        earliest = sent - (measured - turnaround) * MICROSECOND
        width = received - measured * MICROSECOND - earliest
        if not 0 <= width <= MAX_ROUND_TRIP:
            return
        width = max(width, self._resolution)
        new = _Exchange(measured, earliest + width // 2, width)
        if abs(new.middle - self.offset(measured)) > 0.5 * width + self.half_width(received):
            self._kept.clear()
        if self._kept and new.measured // SLOT == self._kept[-1].measured // SLOT:
            if new.width >= self._kept[-1].width:
                return
            self._kept.pop()
        self._kept.append(new)
        self._fit()

    def _fit(self) -> None:
        """Bayesian linear regression of the offset: a line with a prior on its slope."""
        last, narrowest = self._kept[-1], min(self._kept, key=lambda kept: kept.width)
        least, usual = narrowest.width, median_low(kept.width for kept in self._kept)
        # The narrowest one is not yet the least possible: by about so much.
        excess = (usual - least) / sqrt(len(self._kept)) - least
        floor = (JITTER + 0.3 * self._resolution) ** 2
        a = b = c = u = v = 0.0  # normal equations [a b; b c] (offset, drift) = (u, v)
        for kept in self._kept:
            weight = 1.0 / (floor + (kept.width + excess) ** 2 / 12.0)
            t = (kept.measured - last.measured) * MICROSECOND
            y = kept.middle - last.middle
            a, b, c = a + weight, b + weight * t, c + weight * t * t
            u, v = u + weight * y, v + weight * t * y
        c += DRIFT**-2
        determinant = a * c - b * b
        self._origin = last.measured
        self._offset = last.middle + round((c * u - b * v) / determinant)
        self.drift = (a * v - b * u) / determinant
        self._drift_deviation = sqrt(a / determinant)
        self._half_width = 0.5 * least
        # Whatever the many say: the offset lies in each interval, so in the narrowest one.
        off = self.offset(narrowest.measured) - narrowest.middle
        self._offset -= off - max(-least // 2, min(off, least // 2))
        self.round_trip = max(0, least - self._resolution) * 1e-9

    def offset(self, clock: int) -> int:
        """What to add to the link's clock [ns] when it shows `clock` [us]."""
        return self._offset + round(self.drift * (clock - self._origin) * MICROSECOND)

    def half_width(self, now: int) -> float:
        """The offset is known to plus or minus this [ns]."""
        age = max(0, now - self._offset - self._origin * MICROSECOND)
        return self._half_width + 3.0 * self._drift_deviation * age

    def deviation(self, now: int) -> float:
        """Standard deviation of a mapped time [s], the offset being anywhere in its interval."""
        return 1e-9 * self.half_width(now) / sqrt(3.0)

    def to_host(self, clock: int) -> int:
        """Host time [ns] of the link's clock [us]."""
        return clock * MICROSECOND + self.offset(clock)

    def to_link(self, now: int) -> int:
        """The link's clock [us] at host time [ns]; not negative."""
        guess = (now - self._offset) // MICROSECOND
        return max(0, (now - self.offset(guess)) // MICROSECOND)
