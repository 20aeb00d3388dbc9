"""Turn rates of the base by stamp, and its rotation while no camera sees it."""

from array import array
from math import nan

import numpy as np

from fss_arm_calib.segments.samples import MAX_VALUE, OUT_OF_RANGE, Stream
from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.planar import wrap
from fss_arm_model.units import SECOND

MIN_ROTATION_SQUARES = 1.0  # sum of squared base angles needed for a ratio of rotations [rad^2]


class Gyro(Stream):
    """Stream of the base's turn rates."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.rate = array("d")
        self.columns.append((self.rate, 1))
        self._rotations = np.zeros(2)  # sums of gyro * motion capture and motion capture^2 [rad^2]

    def append(self, t: int, rate: float) -> None:
        """Append a rate [rad/s]."""
        if not abs(rate) <= MAX_VALUE:
            self.rejected[OUT_OF_RANGE] += 1
            return
        for stamp, value in self.admit(t, rate):
            self.newest = stamp
            self.t.append(stamp)
            self.rate.append(value)

    def extend(self, t: Stamps, rates: Floats) -> None:
        """Append k rates, (k,) each."""
        if not np.all(np.abs(rates) <= MAX_VALUE) or not self.in_order(t):
            for stamp, rate in zip(t.tolist(), rates.tolist(), strict=True):
                self.append(stamp, rate)
        elif len(t):
            self.t.frombytes(t.tobytes())
            self.rate.frombytes(rates.tobytes())
            self.newest = self.t[-1]

    def angles(self, begin: int, end: int, gap: int) -> tuple[Stamps, Floats] | None:
        """Return stamps and angles turned since the first [rad]; None: a gap exceeds `gap` [ns]."""
        around = self.slice_around(begin, end)
        t, rate = np.array(self.t[around]), np.array(self.rate[around])
        if len(t) < 2 or t[0] > begin or t[-1] < end or np.diff(t).max() > gap:
            return None
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t) / SECOND
        return t, np.concatenate([[0.0], np.cumsum(steps)])

    def compare(self, rotation: tuple[Stamps, Floats], t: Stamps, psi: Floats) -> None:
        """Update the ratio with a rotation by `angles` and by motion capture, psi (k,) at t."""
        angle = np.interp(t - t[0], rotation[0] - t[0], rotation[1])
        a, p = angle - np.mean(angle), psi - np.mean(psi)
        self._rotations += [float(a @ p), float(p @ p)]

    @property
    def ratio(self) -> float:
        """Ratio of the base's rotation by the gyro to that by motion capture; NaN: not known."""
        products, squares = self._rotations
        return products / squares if squares > MIN_ROTATION_SQUARES else nan

    def unwrap(self, t: Stamps, heading: Floats, step: int, gap: int) -> Floats | tuple[int, int]:
        """Unwrap headings (k,) at stamps t; the rates give the turns between poses far apart.

        In a time `step` [ns], the base turns by less than half a turn. If a longer one has a gap in
        the rates longer than `gap` [ns], return the interval in which the base may have turned.
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
