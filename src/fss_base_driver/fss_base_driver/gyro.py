"""Gyro rate from the sums counted by the board, and gyro bias from a time at rest."""

from math import sqrt
from typing import NamedTuple

from fss_base_driver.protocol import BaseTelemetry

MAX_FRAME_INTERVAL = 1_000_000  # between frames; after that the sums may wrap around [us]


class MeanRate(NamedTuple):
    """Mean of some gyro samples."""

    stamp: int  # middle of the averaging time [ns]
    counts: float  # of one sample
    samples: int


class GyroSums:
    """Differences of the sums between frames; a lost frame loses no sample."""

    def __init__(self) -> None:
        self._last: tuple[BaseTelemetry, int] | None = None

    def add(self, frame: BaseTelemetry, stamp: int) -> MeanRate | None:
        """Return the mean since the last frame; None without samples, or if the board restarted.

        Args:
            frame: accepted frames, one after another.
            stamp: time of its measurement [ns].
        """
        last, self._last = self._last, (frame, stamp)
        if last is None:
            return None
        before, then = last
        interval = frame.clock - before.clock
        restarted = frame.boot != before.boot or not 0 < interval <= MAX_FRAME_INTERVAL
        samples = (frame.gyro_samples - before.gyro_samples) & 0xFFFF
        if restarted or not samples:
            return None
        difference = (frame.gyro_sum - before.gyro_sum) & 0xFFFFFFFF
        difference = (difference ^ 1 << 31) - (1 << 31)
        return MeanRate((then + stamp) // 2, difference / samples, samples)


class Bias(NamedTuple):
    """Rate that the gyro reports at rest."""

    rate: float  # [rad/s]
    deviation: float  # 1 sigma, from the scatter [rad/s]

    def __str__(self) -> str:
        return f"gyro.bias is {self.rate:.3g} rad/s, +- {self.deviation:.1g}"


class BiasSearch:
    """Search for the bias: mean rate over a time in which the base is at rest.

    It ends with the bias, or with the reason why there is none. A steady rotation looks like a
    bias: the operator must make sure that the base is held.

    Args:
        duration: averaging time [s].
        scatter: largest scatter of the frames' mean rates for a base at rest [rad/s].
        largest: largest plausible bias [rad/s].
    """

    def __init__(self, duration: float, scatter: float, largest: float) -> None:
        self.outcome: Bias | str | None = None  # None: the search continues
        self._duration, self._scatter, self._largest = duration, scatter, largest
        self._rates: list[tuple[float, int]] = []
        self._begin = 0

    def add(self, stamp: int, rate: float, samples: int, valves: int) -> None:
        """Add a frame's mean rate, without bias correction [rad/s], while the search continues.

        Args:
            stamp: of the rate [ns].
            rate: mean of the frame.
            samples: their number.
            valves: bits of the open ones.
        """
        if self.outcome is None:
            self._begin = self._begin or stamp
            self._rates.append((rate, samples))
            if valves:
                self.outcome = "a valve is open"
            elif stamp - self._begin >= 1e9 * self._duration:
                self.outcome = self._evaluate()

    def fail(self, why: str) -> None:
        """End the search without a bias, unless it has ended."""
        self.outcome = self.outcome or why

    def _evaluate(self) -> Bias | str:
        total = sum(n for _, n in self._rates)
        mean = sum(n * value for value, n in self._rates) / total
        scatter = sqrt(sum(n * (value - mean) ** 2 for value, n in self._rates) / total)
        if scatter > self._scatter:
            return f"the base moves: rates scatter by {scatter:.2g} rad/s"
        if abs(mean) > self._largest:
            return f"the base turns: {mean:.2g} rad/s, a bias is below {self._largest:g}"
        return Bias(mean, scatter / sqrt(len(self._rates)))
