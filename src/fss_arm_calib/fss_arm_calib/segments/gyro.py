"""The base's turn rates by stamp, and what it turned by."""

from array import array

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.samples import LARGEST, OUT_OF_RANGE, SECOND, Stamps, Stream


class Gyro(Stream):
    """The base's turn rates."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.rate = array("d")
        self.columns.append((self.rate, 1))

    def append(self, t: int, rate: float) -> None:
        """Take a rate [rad/s]."""
        if not abs(rate) <= LARGEST:
            self.rejected[OUT_OF_RANGE] += 1
            return
        for stamp, value in self.admit(t, rate):
            self.newest = stamp
            self.t.append(stamp)
            self.rate.append(value)

    def extend(self, t: Stamps, rates: Floats) -> None:
        """Take many, (k,) each."""
        if not np.all(np.abs(rates) <= LARGEST) or not self.in_order(t):
            for stamp, rate in zip(t.tolist(), rates.tolist(), strict=True):
                self.append(stamp, rate)
        elif len(t):
            self.t.frombytes(t.tobytes())
            self.rate.frombytes(rates.tobytes())
            self.newest = self.t[-1]

    def angles(self, begin: int, end: int, gap: int) -> tuple[Stamps, Floats] | None:
        """Stamps and angles turned since the first of them [rad]; None: there is a longer gap."""
        around = self.around(begin, end)
        t, rate = np.array(self.t[around]), np.array(self.rate[around])
        if len(t) < 2 or t[0] > begin or t[-1] < end or np.diff(t).max() > gap:
            return None
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t) / SECOND
        return t, np.concatenate([[0.0], np.cumsum(steps)])

    def turn(self, begin: int, end: int, gap: int) -> float | None:
        """Angle turned in an interval [rad]; None if there is a longer gap [ns] in the rates."""
        found = self.angles(begin, end, gap)
        return None if found is None else float(np.diff(np.interp([begin, end], *found))[0])
