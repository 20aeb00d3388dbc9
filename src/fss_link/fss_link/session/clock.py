"""Mapping of the link's clock to the host's clock, estimated from round trips.

A one-way delay cannot be distinguished from a clock offset, but a round trip bounds the offset. If
a command is sent at s, and the link echoes it with turn-around T in telemetry that is measured at C
and received at r, then

    host - link  in  [s - (C - T), r - C]

The width of this interval is the travel time of both datagrams, w = r - s - T. The error of its
middle is half the difference of the two delays. This error is small when w is close to its minimum.
The link's oscillator drifts, so the offset is modelled as a line over time,

    host - link = o + d (C - C_0),    d ~ N(0, DRIFT^2)

It is fitted by weighted least squares to the middles of the intervals; of each slot of time only
the narrowest interval is used. The standard deviation of a middle is half the excess of its width
over the narrowest width, divided by sqrt(3). The line must pass through the narrowest interval.
Host times are in integer nanoseconds, link times in the protocol's microseconds.
"""

from collections import deque
from dataclasses import dataclass
from math import inf, nan, sqrt
from statistics import median_low

from fss_arm_model.units import SECOND

MICROSECOND = 1000  # [ns]
MAX_ROUND_TRIP = SECOND  # longer round trips are ignored
DRIFT = 1e-4 / sqrt(3.0)  # of a link's oscillator against the host's, 1 sigma
SLOT = 1_000_000  # one interval is stored for each slot, the narrowest [us]
SLOTS = 300  # stored: the drift is assumed constant over this time
JITTER = 20_000.0  # of reading clocks, 1 sigma [ns]


@dataclass(frozen=True, slots=True)
class _Exchange:
    """One round trip."""

    measured: int  # [us]
    middle: int  # of the interval that contains the offset [ns]
    width: int  # of the interval [ns]


class LinkClock:
    """Map from one run of a link's clock to host time.

    Before the first round trip the offset is that of the frame with the least delay: its delay is
    assumed to be zero, and the deviation is infinite.

    Args:
        measured: the link's clock at a measurement [us].
        received: when the host received it [ns].
        resolution: step of the host's clock, nonzero for a simulated clock [ns].
    """

    def __init__(self, measured: int, received: int, resolution: int = 0) -> None:
        self.drift = 0.0
        self.round_trip = nan  # of the narrowest stored exchange, without the turn-around [s]
        self._offset = received - measured * MICROSECOND  # host - link at _origin [ns]
        self._origin = measured  # [us]
        self._kept: deque[_Exchange] = deque(maxlen=SLOTS)
        self._half_width = inf  # of the narrowest stored interval [ns]
        self._drift_deviation = DRIFT
        self._resolution = resolution

    def one_way(self, measured: int, received: int) -> None:
        """Update the offset from a frame that echoes no known command.

        The frame can only be received after its measurement, which bounds the offset.
        """
        if not self._kept:
            self._offset = min(self._offset, received - measured * MICROSECOND)

    def exchange(self, sent: int, turnaround: int, measured: int, received: int) -> None:
        """Update the estimate from a command sent at `sent` [ns] and its echo, `turnaround` in us.

        An exchange of negative duration or of more than 1 s is ignored. An exchange that
        contradicts the estimate means that a clock was set: the estimate is reset.
        """
        received += self._resolution  # the clock's reading may be late by one step
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
        """Fit the offset by Bayesian linear regression: a line with a prior on its slope."""
        last, narrowest = self._kept[-1], min(self._kept, key=lambda kept: kept.width)
        least, usual = narrowest.width, median_low(kept.width for kept in self._kept)
        # Estimated excess of the narrowest width over the least possible width.
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
        # The offset lies in every interval, so limit the fit to the narrowest one.
        off = self.offset(narrowest.measured) - narrowest.middle
        self._offset -= off - max(-least // 2, min(off, least // 2))
        self.round_trip = max(0, least - self._resolution) * 1e-9

    def offset(self, clock: int) -> int:
        """Return the host's time minus the link's [ns] when the link's clock shows `clock` [us]."""
        return self._offset + round(self.drift * (clock - self._origin) * MICROSECOND)

    def half_width(self, now: int) -> float:
        """Return the half-width of the interval that contains the offset [ns]."""
        age = max(0, now - self._offset - self._origin * MICROSECOND)
        return self._half_width + 3.0 * self._drift_deviation * age

    def deviation(self, now: int) -> float:
        """Return the standard deviation of a mapped time [s], for a uniform offset."""
        return 1e-9 * self.half_width(now) / sqrt(3.0)

    def to_host(self, clock: int) -> int:
        """Convert the link's clock [us] to host time [ns]."""
        return clock * MICROSECOND + self.offset(clock)

    def to_link(self, now: int) -> int:
        """Convert host time [ns] to the link's clock [us]; not negative."""
        guess = (now - self._offset) // MICROSECOND
        return max(0, (now - self.offset(guess)) // MICROSECOND)
