"""Statistics of a node that runs at a fixed rate: period, latency, and missed deadlines."""

import numpy as np
from rclpy.node import Node

from fss_arm_model.units import SECOND
from fss_arm_ros.timers import timer_clock

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

    Steps are timed by the clock of the node's timers, and latencies by that of its stamps.

    Args:
        rate: nominal rate of the steps, which a timer makes [1/s].
        node: whose clocks are used.
    """

    def __init__(self, rate: float, node: Node) -> None:
        self._period = SECOND / rate  # nominal [ns]
        self._timer_clock, self._clock = timer_clock(node), node.get_clock()
        self._periods, self._latencies = Samples(), Samples()
        self._start: int | None = None  # time of the first step without an interruption [ns]
        self._last, self._made = 0, 0  # time of the last step [ns]; steps since the first
        self._missed_before, self._missed_since = 0, 0  # before the first step; since it

    @property
    def missed(self) -> int:
        """Number of steps that were due and not made; a timer that is late keeps its phase."""
        return self._missed_before + self._missed_since

    def add_step(self) -> None:
        """Add a step that is made now."""
        now = int(self._timer_clock.now().nanoseconds)
        if now < self._last:  # simulated time was set back
            self.interrupt()
        if self._start is None:
            self._start, self._made = now, 0
        else:
            self._periods.add(now - self._last)
            self._made += 1
            missed = int((now - self._start) / self._period) - self._made
            self._missed_since = max(self._missed_since, missed)
        self._last = now

    def add_command(self, measured: int | None) -> None:
        """Add a command that is given now; its newest measurement was made at `measured` [ns]."""
        if measured is not None:
            self._latencies.add(int(self._clock.now().nanoseconds) - measured)

    def interrupt(self) -> None:
        """Note that no step follows for a while, so that this is not a long period."""
        self._missed_before, self._missed_since, self._start = self.missed, 0, None

    def values(self) -> dict[str, float]:
        """Return percentiles and missed deadlines by name, for diagnostics; empty without steps."""
        periods = self._periods.percentiles("period")
        missed = {MISSED: self.missed} if periods else {}
        return {**periods, **self._latencies.percentiles("latency"), **missed}
