"""What was heard of a bag, kept to be heard again with something changed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.samples import SECOND, Stamps

PIECE = 10 * SECOND  # of streams, fed one after the other [ns]


class Track(NamedTuple):
    """k samples of a stream."""

    t: Stamps  # (k,) their stamps [ns]
    receipt: Stamps  # (k,) [ns]
    values: Floats  # (k, c)

    def thinned(self, period: float) -> "Track":
        """Without samples that follow another one by less than a period [s], about."""
        if len(self.t) < 2:
            return self
        found = max(float(np.median(np.abs(np.diff(self.t)))) / SECOND, 1e-9)
        step = max(1, round(period / found))
        return Track(self.t[::step], self.receipt[::step], self.values[::step])

    def since(self, begin: int) -> "Track":
        """What was received from `begin` on [ns]."""
        late = self.receipt >= begin
        return Track(self.t[late], self.receipt[late], self.values[late])


@dataclass(frozen=True)
class Recorded:
    """What was heard of the joints, of subjects and of the gyro."""

    joints: Mapping[str, Track]  # by name, whatever it is: readings [rad] and rates [rad/s]
    poses: Mapping[str, Track]  # by subject: x, y, z [m], quaternion x, y, z, w
    rates: Track | None = None  # of the base [rad/s]
    frames: Mapping[str, str] = field(default_factory=dict)  # frame id of each subject

    @property
    def tracks(self) -> list[Track]:
        """All of them."""
        return [*self.joints.values(), *self.poses.values(), *([self.rates] if self.rates else [])]

    def brief(self, longest: float, joints: float, poses: float) -> "Recorded":
        """Its last part [s], with periods no shorter than these [s]."""
        ends = [int(track.receipt[-1]) for track in self.tracks if len(track.t)]
        begin = max(ends, default=0) - round(longest * SECOND)
        return replace(
            self,
            joints={n: track.since(begin).thinned(joints) for n, track in self.joints.items()},
            poses={n: track.since(begin).thinned(poses) for n, track in self.poses.items()},
            rates=self.rates.since(begin).thinned(poses) if self.rates else None,
        )

    def with_joints(self, change: Callable[[str, Track], Track]) -> "Recorded":
        """The same with other readings."""
        return replace(self, joints={name: change(name, t) for name, t in self.joints.items()})

    def with_poses(self, change: Callable[[str, Track], Track]) -> "Recorded":
        """The same with other poses."""
        return replace(self, poses={name: change(name, t) for name, t in self.poses.items()})

    def play(self, finder: Finder[Any, Any]) -> Sequence[Any]:
        """What a finder makes of it."""
        planar = {name: seen_from_above(track.values) for name, track in self.poses.items()}
        names = {f"joint_{i}": i for i in range(1, len(finder.joints) + 1)}
        heard = [int(t) for one in self.tracks if len(one.t) for t in one.receipt[[0, -1]]]
        found: list[Any] = []
        for begin in range(min(heard, default=0), max(heard, default=-1) + 1, PIECE):
            for name, track in self.joints.items():
                those = _piece(track, begin)
                rows = zip(track.t[those].tolist(), track.values[those].tolist(), strict=True)
                for t, (q, qd) in rows if name in names else ():
                    found += finder.joint(names[name], t, q, qd)
            for name, track in self.poses.items():
                those = _piece(track, begin)
                found += finder.poses(name, track.t[those], planar[name][those])
            if self.rates:
                those = _piece(self.rates, begin)
                found += finder.rates(self.rates.t[those], self.rates.values[those, 0])
        return found + finder.close()


def _piece(track: Track, begin: int) -> slice:
    return slice(*np.searchsorted(track.receipt, [begin, begin + PIECE]).tolist())


def seen_from_above(numbers: Floats) -> Floats:
    """(k, 3) x, y [m] and heading [rad] of poses (k, 7); NaN where nothing was seen."""
    x, y, z, w = numbers[:, 3:].T
    heading = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    seen = np.isfinite(numbers).all(axis=1) & (x * x + y * y + z * z + w * w >= 0.25)
    return np.where(seen[:, None], np.column_stack([numbers[:, :2], heading]), np.nan)
