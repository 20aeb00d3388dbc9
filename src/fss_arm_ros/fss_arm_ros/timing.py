"""Statistics of a node that runs at a fixed rate: period, latency, and missed deadlines."""

from typing import TYPE_CHECKING

import numpy as np

from fss_arm_model.units import SECOND

if TYPE_CHECKING:  # a pure class otherwise
    from rclpy.clock import Clock

MAX_SAMPLES = 10_000  # newest ones that percentiles are computed from
PERCENTILES = (50.0, 99.0, 99.9)
MISSED = "missed deadlines"


class Samples:
    """The newest durations [ms]."""

    def __init__(self) -> None:
        self._values, self._count = np.empty(MAX_SAMPLES), 0

    def add(self, duration: int) -> None:
        """Add a duration [ns]."""
        self._values[self._count % MAX_SAMPLES] = 1e-6 * duration
        self._count += 1

    def percentiles(self, name: str) -> dict[str, float]:
        """Return percentiles [ms] by name, for diagnostics; empty without samples."""
        if not self._count:
            return {}
        found = np.percentile(self._values[: self._count], PERCENTILES).tolist()
        return dict(zip(percentile_names(name), found, strict=True))


def percentile_names(name: str) -> list[str]:
    """Return the keys of a duration's percentiles in diagnostics."""
    return [f"{name} p{percent:g} [ms]" for percent in PERCENTILES]


class Timing:
    """Periods between the steps of a node, and latencies from a measurement to its command.

    Args:
        rate: nominal rate of the steps [1/s].
        clock: of the steps and of the stamps of measurements.
    """

    def __init__(self, rate: float, clock: "Clock") -> None:
        self._period, self._clock = SECOND / rate, clock  # nominal [ns]
        self._periods, self._latencies = Samples(), Samples()
        self._last: int | None = None  # time of the last step [ns]
        self.missed = 0  # steps that were due and not made

    def add_step(self) -> None:
        """Add a step that is made now."""
        now = int(self._clock.now().nanoseconds)
        if self._last is not None:
            self._periods.add(now - self._last)
            self.missed += max(0, round((now - self._last) / self._period) - 1)
        self._last = now

    def add_command(self, measured: int | None) -> None:
        """Add a command that is given now; its newest measurement was made at `measured` [ns]."""
        if measured is not None:
            self._latencies.add(int(self._clock.now().nanoseconds) - measured)

    def interrupt(self) -> None:
        """Note that no step follows for a while, so that this is not a long period."""
        self._last = None

    def values(self) -> dict[str, float]:
        """Return percentiles and missed deadlines by name, for diagnostics; empty without steps."""
        periods = self._periods.percentiles("period")
        missed = {MISSED: self.missed} if periods else {}
        return {**periods, **self._latencies.percentiles("latency"), **missed}
