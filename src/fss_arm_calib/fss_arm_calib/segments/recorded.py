"""Streams recorded in a bag, kept in memory to replay them with modifications."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.samples import SECOND, Stamps

PIECE = 10 * SECOND  # length of the pieces in which streams are replayed in turn [ns]


class Track(NamedTuple):
    """Stream of k samples."""

    t: Stamps  # (k,) stamps [ns]
    receipt: Stamps  # (k,) times of receipt [ns]
    values: Floats  # (k, c)

    def thinned(self, period: float) -> "Track":
        """Return every n-th sample, so that their mean distance is about a period [s]."""
        if len(self.t) < 2:
            return self
        found = max(float(np.median(np.abs(np.diff(self.t)))) / SECOND, 1e-9)
        step = max(1, round(period / found))
        return Track(self.t[::step], self.receipt[::step], self.values[::step])

    def since(self, begin: int) -> "Track":
        """Return the samples received at or after `begin` [ns]."""
        late = self.receipt >= begin
        return Track(self.t[late], self.receipt[late], self.values[late])


@dataclass(frozen=True)
class Recorded:
    """Recorded streams of the joints, the subjects and the gyro."""

    joints: Mapping[str, Track]  # by any recorded name: readings [rad] and rates [rad/s]
    poses: Mapping[str, Track]  # by subject: x, y, z [m], quaternion x, y, z, w
    rates: Track | None = None  # turn rates of the base [rad/s]
    frames: Mapping[str, str] = field(default_factory=dict)  # frame id of each subject

    @property
    def tracks(self) -> list[Track]:
        """List of all streams."""
        return [*self.joints.values(), *self.poses.values(), *([self.rates] if self.rates else [])]

    def brief(self, longest: float, joints: float, poses: float) -> "Recorded":
        """Return the last `longest` [s], thinned to periods of `joints` and `poses` [s]."""
        ends = [int(track.receipt[-1]) for track in self.tracks if len(track.t)]
        begin = max(ends, default=0) - round(longest * SECOND)
        return replace(
            self,
            joints={n: track.since(begin).thinned(joints) for n, track in self.joints.items()},
            poses={n: track.since(begin).thinned(poses) for n, track in self.poses.items()},
            rates=self.rates.since(begin).thinned(poses) if self.rates else None,
        )

    def with_joints(self, change: Callable[[str, Track], Track]) -> "Recorded":
        """Return the recording with modified readings."""
        return replace(self, joints={name: change(name, t) for name, t in self.joints.items()})

    def with_poses(self, change: Callable[[str, Track], Track]) -> "Recorded":
        """Return the recording with modified poses."""
        return replace(self, poses={name: change(name, t) for name, t in self.poses.items()})

    def play(self, finder: Finder[Any, Any]) -> Sequence[Any]:
        """Replay the streams to a finder and return the segments that it finds."""
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
    """Return x, y [m] and heading [rad], (k, 3), of poses (k, 7); NaN where nothing was seen."""
    x, y, z, w = numbers[:, 3:].T
    heading = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    seen = np.isfinite(numbers).all(axis=1) & (x * x + y * y + z * z + w * w >= 0.25)
    return np.where(seen[:, None], np.column_stack([numbers[:, :2], heading]), np.nan)
