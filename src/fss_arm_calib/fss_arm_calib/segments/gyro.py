"""The base's turn rates by stamp, and what it turned by where no camera saw it."""

from array import array

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.samples import LARGEST, OUT_OF_RANGE, SECOND, Stamps, Stream
from fss_arm_model.planar import wrap


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

    def unwrap(self, t: Stamps, heading: Floats, step: int, gap: int) -> Floats | tuple[int, int]:
        """Headings (k,) that count turns, the rates telling those between poses far apart.

        Args:
            t: (k,) their stamps [ns].
            heading: (k,) as seen [rad].
            step: the base turns by less than half a turn meanwhile [ns].
            gap: longest in the rates [ns].

        Returns:
            (k,) headings; or an interval in which the base may have turned unseen.
        """
        bridge = np.zeros(len(t))
        for k in np.flatnonzero(np.diff(t) > step):
            unseen = int(t[k]), int(t[k + 1])
            found = self.angles(*unseen, gap)
            if found is None:
                return unseen
            bridge[k + 1] = np.diff(np.interp(unseen, *found))[0]
        steps = np.diff(heading, prepend=heading[:1])
        return np.asarray(heading[:1] + np.cumsum(bridge + wrap(steps - bridge)))
