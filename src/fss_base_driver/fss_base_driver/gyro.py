"""The gyro's rate from the sums that the board counts, and its bias from a while at rest."""

from math import sqrt
from typing import NamedTuple

from fss_base_driver.protocol import BaseTelemetry

LONGEST = 1_000_000  # from one frame to the next; sums may have gone round in more [us]


class Turn(NamedTuple):
    """The mean of some samples."""

    stamp: int  # middle of their time [ns]
    counts: float  # of one sample
    samples: int


class Sums:
    """Differences of the sums from frame to frame, so that a lost frame loses nothing."""

    def __init__(self) -> None:
        self._last: tuple[BaseTelemetry, int] | None = None

    def take(self, frame: BaseTelemetry, stamp: int) -> Turn | None:
        """The mean since the last frame; None if nothing was sampled, or the board restarted.

        Args:
            frame: one after another, as they are believed.
            stamp: time of its measurement [ns].
        """
        last, self._last = self._last, (frame, stamp)
        if last is None:
            return None
        before, then = last
        again = frame.boot != before.boot or not 0 < frame.clock - before.clock <= LONGEST
        samples = (frame.gyro_samples - before.gyro_samples) & 0xFFFF
        if again or not samples:
            return None
        difference = (frame.gyro_sum - before.gyro_sum) & 0xFFFFFFFF
        difference = (difference ^ 1 << 31) - (1 << 31)
        return Turn((then + stamp) // 2, difference / samples, samples)


class BiasError(ValueError):
    """The bias was not found; the message says why."""


class BiasSearch:
    """The mean rate over a while in which the base is at rest.

    What turns steadily looks like a bias: that the base is held is for a person to see to.

    Args:
        duration: for how long [s].
        scatter: of the frames' mean rates that a base at rest does not exceed [rad/s].
        largest: bias that is believed [rad/s].
    """

    def __init__(self, duration: float, scatter: float, largest: float) -> None:
        self._duration, self._scatter, self._largest = duration, scatter, largest
        self._rates: list[tuple[float, int]] = []
        self._begin = self._end = 0

    def take(
        self, stamp: int, rate: float, samples: int, valves: int
    ) -> tuple[float, float] | None:
        """Learn a frame's mean rate, without a bias taken off [rad/s].

        Returns:
            Bias and its standard deviation, by the scatter [rad/s], once it has taken long enough.

        Raises:
            BiasError: a valve is open, or the base turns.
        """
        if valves:
            raise BiasError("a valve is open")
        self._begin, self._end = self._begin or stamp, stamp
        self._rates.append((rate, samples))
        if self._end - self._begin < 1e9 * self._duration:
            return None
        total = sum(n for _, n in self._rates)
        mean = sum(n * value for value, n in self._rates) / total
        scatter = sqrt(sum(n * (value - mean) ** 2 for value, n in self._rates) / total)
        if scatter > self._scatter:
            raise BiasError(f"the base moves: rates scatter by {scatter:.2g} rad/s")
        if abs(mean) > self._largest:
            raise BiasError(f"the base turns: {mean:.2g} rad/s, a bias is below {self._largest:g}")
        return mean, scatter / sqrt(len(self._rates))
