"""Remaining time of a link's battery, from a line fitted to its voltage."""

from collections import deque
from math import inf, nan

from fss_arm_model.units import SECOND

READING_INTERVAL = 10 * SECOND  # between stored readings
MAX_READINGS = 180  # stored: half an hour
MIN_READINGS = 12  # to fit a line: two minutes
MAX_TIME_LEFT = 600_000.0  # [s]; a longer one is rounding or noise of a constant voltage


class Battery:
    """Line fitted to the voltage of the last half hour. Times are the caller's, in nanoseconds.

    Args:
        empty: voltage at which the link must be switched off [V].
    """

    def __init__(self, empty: float) -> None:
        self.voltage = nan  # last reading [V]
        self._empty = empty
        self._readings: deque[tuple[float, float]] = deque(maxlen=MAX_READINGS)  # [s], [V]
        self._next = 0

    def add(self, voltage: float, now: int) -> None:
        """Add a reading [V]."""
        self.voltage = voltage
        if now < self._next - READING_INTERVAL:  # the clock was set back
            self._readings.clear()
            self._next = now
        if now >= self._next:
            self._readings.append((1e-9 * now, voltage))
            self._next = now + READING_INTERVAL

    def time_left(self) -> float:
        """Estimate the time until it is empty [s].

        Infinite beyond MAX_TIME_LEFT, as if the voltage does not fall; NaN while there are fewer
        than MIN_READINGS readings.
        """
        if len(self._readings) < MIN_READINGS:
            return nan
        n = len(self._readings)
        t0 = self._readings[0][0]
        t = sum(at - t0 for at, _ in self._readings) / n
        v = sum(voltage for _, voltage in self._readings) / n
        variance = sum((at - t0 - t) ** 2 for at, _ in self._readings)
        slope = sum((at - t0 - t) * (voltage - v) for at, voltage in self._readings) / variance
        if slope >= 0.0:
            return inf
        now = v + slope * (self._readings[-1][0] - t0 - t)
        left = max(0.0, (now - self._empty) / -slope)
        return left if left < MAX_TIME_LEFT else inf
