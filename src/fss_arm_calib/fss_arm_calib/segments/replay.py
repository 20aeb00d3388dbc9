"""Replay of recorded streams to a finder."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fss_arm_bags.recorded import Recorded, Track
from fss_arm_calib.segments.finder import Finder
from fss_arm_model.description import joint_names
from fss_arm_model.planar import project_to_plane
from fss_arm_model.units import SECOND

CHUNK_DURATION = 10 * SECOND  # length of the chunks in which streams are replayed in turn [ns]


def replay(recorded: Recorded, finder: Finder[Any, Any]) -> Sequence[Any]:
    """Replay the streams to a finder and return the segments that it finds."""
    planar = {name: project_to_plane(track.values) for name, track in recorded.poses.items()}
    names = {name: i for i, name in enumerate(joint_names(len(finder.sensors.joints)), 1)}
    times = [int(t) for one in recorded.tracks if len(one.t) for t in one.receipt[[0, -1]]]
    found: list[Any] = []
    for begin in range(min(times, default=0), max(times, default=-1) + 1, CHUNK_DURATION):
        for name, track in recorded.joints.items():
            chunk = _chunk(track, begin)
            rows = zip(track.t[chunk].tolist(), track.values[chunk].tolist(), strict=True)
            for t, (q, qd) in rows if name in names else ():
                found += finder.add_reading(names[name], t, q, qd)
        for name, track in recorded.poses.items():
            chunk = _chunk(track, begin)
            found += finder.add_poses(name, track.t[chunk], planar[name][chunk])
        for track in recorded.rates.values():
            chunk = _chunk(track, begin)
            found += finder.add_rates(track.t[chunk], track.values[chunk, 0])
    return found + finder.close()


def _chunk(track: Track, begin: int) -> slice:
    return slice(*np.searchsorted(track.receipt, [begin, begin + CHUNK_DURATION]).tolist())
