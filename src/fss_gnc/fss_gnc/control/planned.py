"""Joint accelerations from a plan of the joints' rates, one period at a time.

The wrench must balance the change of the joints' rates over a period. The mean acceleration of a
period is therefore computed from the rates at the end of the last period to those planned for the
end of this one. If a plan arrives late, or a rate jumps, the next period compensates for it.

A plan with rates for one time only is a measurement of the joints' motion. Balancing its noise
would shake the base, which in turn disturbs the joints; with a heavy target at the end of the arm
this would grow with each period. A plan that ended long ago is ignored: the base has already
reacted to whatever the joints have done since.
"""

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND

MAX_EXTRAPOLATION = 1.0  # time before or after a plan's times at which it is ignored [s]


class PlannedRates:
    """Planned rates of n joints."""

    def __init__(self) -> None:
        self._stamp, self._times = 0, np.zeros(1)
        self._rates: Floats | None = None  # (k, n)
        self._last_rates: Floats | None = None  # (n,) at the end of the last period

    def store(self, stamp: int, times: Floats, rates: Floats) -> None:
        """Store rates (k, n) [rad/s], planned for increasing times (k,) [s] after a stamp [ns]."""
        self._stamp, self._times, self._rates = stamp, times, rates

    def accelerations(self, now: int, period: float) -> Floats | None:
        """Return the mean over a period [s] from now [ns], (n,) [rad/s^2]; None without a plan."""
        t = (now - self._stamp) / SECOND
        if self._rates is None or not -MAX_EXTRAPOLATION < t < self._times[-1] + MAX_EXTRAPOLATION:
            self.reset()
            return None
        end = self._rates_at(t + period)
        start = end if self._last_rates is None else self._last_rates
        self._last_rates = end
        return (end - start) / period if len(self._times) > 1 else np.zeros(end.size)

    def reset(self) -> None:
        """Forget the rates of the last period, in which nothing was compensated."""
        self._last_rates = None

    def _rates_at(self, t: float) -> Floats:
        assert self._rates is not None
        return np.array([np.interp(t, self._times, column) for column in self._rates.T])
