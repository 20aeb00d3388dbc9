"""The joints' accelerations as a plan of their rates gives them, a period at a time.

What the wrench must balance over periods is the change of the joints' rates. The mean acceleration
of a period is therefore from the rates that were reached before to those planned for its end: a
plan that is told late, or a rate that jumps, is made up for in the next period.

Rates for one time are no plan but what the joints do. To balance their noise would shake the base,
which they feel, and with a heavy target at the end of the arm more at each period. A plan that is
long over says nothing any more: whatever the joints have done since then, the base has felt.
"""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SECOND = 1_000_000_000
OVER = 1.0  # past a plan's times, or before them, at which it says nothing [s]


class PlannedRates:
    """Rates of n joints to come."""

    def __init__(self) -> None:
        self._stamp, self._ahead = 0, np.zeros(1)
        self._rates: Floats | None = None  # (k, n)
        self._reached: Floats | None = None  # (n,) at the end of the last period

    def take(self, stamp: int, ahead: Floats, rates: Floats) -> None:
        """Rates (k, n) [rad/s] are planned for times (k,), rising, after a stamp [ns]."""
        self._stamp, self._ahead, self._rates = stamp, ahead, rates

    def accelerations(self, now: int, period: float) -> Floats | None:
        """Mean over the period [s] from now [ns] on, (n,) [rad/s^2]; None: nothing is planned."""
        t = (now - self._stamp) / SECOND
        if self._rates is None or not -OVER < t < self._ahead[-1] + OVER:
            self.reset()
            return None
        end = self._at(t + period)
        begin = end if self._reached is None else self._reached
        self._reached = end
        return (end - begin) / period if len(self._ahead) > 1 else np.zeros(end.size)

    def reset(self) -> None:
        """Nothing was balanced in the last period."""
        self._reached = None

    def _at(self, t: float) -> Floats:
        assert self._rates is not None
        return np.array([np.interp(t, self._ahead, column) for column in self._rates.T])
