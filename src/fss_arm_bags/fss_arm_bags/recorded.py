"""Streams recorded in a bag, kept in memory to examine them and to replay them with changes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.units import SECOND


class Track(NamedTuple):
    """Stream of k samples."""

    t: Stamps  # (k,) stamps [ns]
    receipt: Stamps  # (k,) times of receipt [ns]
    values: Floats  # (k, c)

    def thin(self, period: float) -> "Track":
        """Return every n-th sample, so that their mean distance is about a period [s]."""
        if len(self.t) < 2:
            return self
        recorded = max(float(np.median(np.abs(np.diff(self.t)))) / SECOND, 1e-9)
        step = max(1, round(period / recorded))
        return Track(self.t[::step], self.receipt[::step], self.values[::step])

    def received_since(self, begin: int) -> "Track":
        """Return the samples received at or after `begin` [ns]."""
        keep = self.receipt >= begin
        return Track(self.t[keep], self.receipt[keep], self.values[keep])

    def stamped_by_receipt(self) -> "Track":
        """Return it with stamps of the receiver's clock; the smallest delay is taken as zero."""
        if not len(self.t):
            return self
        return self._replace(t=self.t + int(np.min(self.receipt - self.t)))


@dataclass(frozen=True)
class Recorded:
    """Recorded streams of the joints, the subjects and the gyro."""

    joints: Mapping[str, Track]  # by any recorded name: readings [rad] and rates [rad/s]
    poses: Mapping[str, Track]  # by subject: x, y, z [m], quaternion x, y, z, w
    rates: Mapping[str, Track] = field(default_factory=dict)  # turn rates of the base [rad/s]

    @property
    def tracks(self) -> list[Track]:
        """List of all streams."""
        return [*self.joints.values(), *self.poses.values(), *self.rates.values()]

    def change(self, **changes: Callable[[str, Track], Track]) -> "Recorded":
        """Return the recording with `joints`, `poses` or `rates` changed by functions of each."""
        changed = {
            part: {name: change(name, track) for name, track in getattr(self, part).items()}
            for part, change in changes.items()
        }
        return replace(self, **changed)

    def shorten(self, duration: float, joints: float, poses: float) -> "Recorded":
        """Return the last `duration` [s], thinned to periods of `joints` and `poses` [s]."""
        ends = [int(track.receipt[-1]) for track in self.tracks if len(track.t)]
        begin = max(ends, default=0) - round(duration * SECOND)

        def thinned(period: float) -> Callable[[str, Track], Track]:
            return lambda _, track: track.received_since(begin).thin(period)

        return self.change(joints=thinned(joints), poses=thinned(poses), rates=thinned(poses))


def unwrap_headings(heading: Floats) -> Floats:
    """Return the headings unwrapped, and interpolated where the subject was not seen."""
    seen = np.flatnonzero(np.isfinite(heading))
    if not len(seen):
        return np.zeros(len(heading))
    return np.interp(np.arange(len(heading)), seen, np.unwrap(heading[seen]))
