"""Statistics of the times of commands: period, latency, and missed deadlines."""

from collections import deque

import numpy as np

from fss_arm_model.units import SECOND

MAX_SAMPLES = 10_000  # newest ones that percentiles are computed from
PERCENTILES = (50.0, 99.0, 99.9)


class Timing:
    """Periods between commands, and latencies from the measurement of the base to the command."""

    def __init__(self) -> None:
        self._samples: dict[str, deque[float]] = {
            name: deque(maxlen=MAX_SAMPLES) for name in ("period", "latency")
        }
        self._last: int | None = None  # time of the last command [ns]

    def add(self, published: int, measured: int) -> None:
        """Add a command: when it was published, and its newest measurement was made [ns]."""
        if self._last is not None:
            self._samples["period"].append((published - self._last) / SECOND)
        self._samples["latency"].append((published - measured) / SECOND)
        self._last = published

    def interrupt(self) -> None:
        """Note that no command follows for a while, so that this is not a long period."""
        self._last = None

    def values(self) -> dict[str, float]:
        """Return percentiles by name, for diagnostics; empty without commands."""
        return {
            f"{name} p{percent:g} [ms]": 1e3 * value
            for name, samples in self._samples.items()
            if samples
            for percent, value in zip(
                PERCENTILES, np.percentile(samples, PERCENTILES).tolist(), strict=True
            )
        }
