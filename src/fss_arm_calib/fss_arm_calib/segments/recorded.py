"""Streams recorded in a bag, kept in memory to replay them with modifications."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.samples import Stamps
from fss_arm_model.arrays import Floats
from fss_arm_model.planar import project_to_plane
from fss_arm_model.units import SECOND

CHUNK_DURATION = 10 * SECOND  # length of the chunks in which streams are replayed in turn [ns]


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

    def replay(self, finder: Finder[Any, Any]) -> Sequence[Any]:
        """Replay the streams to a finder and return the segments that it finds."""
        planar = {name: project_to_plane(track.values) for name, track in self.poses.items()}
        names = {f"joint_{i}": i for i in range(1, len(finder.sensors.joints) + 1)}
        times = [int(t) for one in self.tracks if len(one.t) for t in one.receipt[[0, -1]]]
        found: list[Any] = []
        for begin in range(min(times, default=0), max(times, default=-1) + 1, CHUNK_DURATION):
            for name, track in self.joints.items():
                chunk = _chunk(track, begin)
                rows = zip(track.t[chunk].tolist(), track.values[chunk].tolist(), strict=True)
                for t, (q, qd) in rows if name in names else ():
                    found += finder.add_reading(names[name], t, q, qd)
            for name, track in self.poses.items():
                chunk = _chunk(track, begin)
                found += finder.add_poses(name, track.t[chunk], planar[name][chunk])
            for track in self.rates.values():
                chunk = _chunk(track, begin)
                found += finder.add_rates(track.t[chunk], track.values[chunk, 0])
        return found + finder.close()


def _chunk(track: Track, begin: int) -> slice:
    return slice(*np.searchsorted(track.receipt, [begin, begin + CHUNK_DURATION]).tolist())
