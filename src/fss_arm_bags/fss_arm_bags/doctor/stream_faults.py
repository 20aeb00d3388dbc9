"""Faults of recorded streams that hide data or make them useless, whatever the arm."""

from collections.abc import Iterator, Sequence

import numpy as np

from fss_arm_bags.recorded import Recorded, Track
from fss_arm_model.units import SECOND

MIN_SHARE = 0.3  # share of a stream's samples, or of its time, with a fault that hides data
MIN_JUMP = 0.25  # smaller jumps of a clock are ignored [s]
MIN_TRAVEL = 0.1  # motion of a joint that changes the poses of base and end effector [rad]


def find_faults(recorded: Recorded) -> Iterator[str]:
    """Describe the faults of recorded streams, each with the streams that have it."""
    found: dict[str, list[str]] = {}
    streams = {**recorded.joints, **recorded.poses, **recorded.rates}
    for name, track in streams.items():
        if len(track.t) > 1 and (words := _stamp_fault(track)):
            found.setdefault(words, []).append(name)
    for name, track in recorded.poses.items():
        if len(track.t) > 1 and (words := _pose_fault(track, recorded)):
            found.setdefault(words, []).append(name)
    for words, names in found.items():
        yield words.format(name_streams(names, recorded))


def name_streams(names: Sequence[str], recorded: Recorded) -> str:
    """Return the names of streams; `the joints` if all joints are among them."""
    every = bool(recorded.joints) and set(names) >= recorded.joints.keys()
    others = [name for name in names if not every or name not in recorded.joints]
    return ", ".join(["the joints"] * every + others)


def _stamp_fault(track: Track) -> str:
    if np.mean(track.t == 0) > MIN_SHARE:
        return "stamps of {} are 0: their driver does not set them"
    if np.mean(np.diff(track.t) < 0) > MIN_SHARE:
        return "clock of {} runs backwards"
    late = (track.receipt - track.t) / SECOND
    k = 1 + int(np.argmax(np.abs(np.diff(late))))
    jump = float(np.median(late[:k]) - np.median(late[k:]))
    if abs(jump) <= MIN_JUMP or min(k, len(late) - k) < 10:
        return ""
    since = (track.receipt[k] - track.receipt[0]) / SECOND
    way = "ahead" if jump > 0.0 else "back"
    return f"clock of {{}} jumps {way} by {abs(jump):.3g} s, {since:.0f} s after its first message"


def _pose_fault(track: Track, recorded: Recorded) -> str:
    turned = np.sum(track.values[:, 3:] ** 2, axis=1) >= 0.25
    if np.mean(~turned & track.values[:, :3].any(axis=1)) > MIN_SHARE:
        return "quaternions of {} are 0: the poses have no orientation"
    changes = np.flatnonzero(np.any(np.diff(track.values, axis=0), axis=1) | ~turned[1:])
    edges = track.receipt[[0, *(changes + 1), -1]]
    k = int(np.argmax(np.diff(edges)))
    begin, end = int(edges[k]), int(edges[k + 1])
    seconds = (end - begin) / SECOND
    if seconds <= MIN_SHARE * (edges[-1] - edges[0]) / SECOND:
        return ""
    for joint in recorded.joints.values():
        q = joint.values[(joint.receipt > begin) & (joint.receipt < end), 0]
        if len(q) and np.nanmax(q) - np.nanmin(q) > MIN_TRAVEL:
            return f"pose of {{}} frozen for {seconds:.0f} s while joints moved"
    return ""
