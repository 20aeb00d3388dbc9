"""Faults of recorded streams that hide data or make them useless, whatever the arm."""

from collections.abc import Iterator, Sequence

import numpy as np

from fss_arm_bags.recorded import Recorded, Track
from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND

MIN_SHARE = 0.3  # share of a stream's samples, or of its time, with a fault that hides data
MIN_JUMP = 0.25  # smaller jumps of a clock are ignored [s]
MIN_RATE_ERROR = 1e-3  # smaller relative errors of a clock's rate are ignored
MAX_UNEXPLAINED = 0.2  # share of the delays' spread that a wrong rate may leave
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
    if words := _rate_fault(track, late):
        return words
    k = 1 + int(np.argmax(np.abs(np.diff(late))))
    jump = float(np.median(late[:k]) - np.median(late[k:]))
    if abs(jump) <= MIN_JUMP or min(k, len(late) - k) < 10:
        return ""
    since = (track.receipt[k] - track.receipt[0]) / SECOND
    way = "ahead" if jump > 0.0 else "back"
    return f"clock of {{}} jumps {way} by {abs(jump):.3g} s, {since:.0f} s after its first message"


def _rate_fault(track: Track, late: Floats) -> str:
    """Describe a clock that runs too fast or slow; empty: none, or the delays are not linear."""
    if len(late) < 10 or track.receipt[-1] == track.receipt[0]:
        return ""
    own = (track.t - track.t[0]) / SECOND
    received = (track.receipt - track.receipt[0]) / SECOND
    rate, start = np.polyfit(received, own, 1)
    left = np.ptp(own - rate * received - start)
    error = abs(rate - 1.0)
    if error * received[-1] < MIN_JUMP or left > MAX_UNEXPLAINED * np.ptp(late):
        return ""
    if error < MIN_RATE_ERROR:
        return ""
    if 0.5 < rate < 2.0:
        return f"clock of {{}} runs {100.0 * error:.2g} % {'fast' if rate > 1.0 else 'slow'}"
    return f"clock of {{}} runs {rate:.2g} times as fast as that of the receiver"


def _pose_fault(track: Track, recorded: Recorded) -> str:
    turned = np.sum(track.values[:, 3:] ** 2, axis=1) >= 0.25
    if np.mean(~turned & track.values[:, :3].any(axis=1)) > MIN_SHARE:
        return "quaternions of {} are 0: the poses have no orientation"
    for what, columns in (("pose", slice(0, 7)), ("heading", slice(3, 7))):
        changed = np.any(np.diff(track.values[:, columns], axis=0), axis=1) | ~turned[1:]
        edges = track.receipt[[0, *(np.flatnonzero(changed) + 1), -1]]
        k = int(np.argmax(np.diff(edges)))
        begin, end = int(edges[k]), int(edges[k + 1])
        if end - begin > MIN_SHARE * (edges[-1] - edges[0]) and _joints_moved(recorded, begin, end):
            seconds = (end - begin) / SECOND
            return f"{what} of {{}} frozen for {seconds:.0f} s while joints moved"
    return ""


def _joints_moved(recorded: Recorded, begin: int, end: int) -> bool:
    """Return True if a joint moved between two times of receipt [ns]."""
    for joint in recorded.joints.values():
        q = joint.values[(joint.receipt > begin) & (joint.receipt < end), 0]
        if len(q) and np.nanmax(q) - np.nanmin(q) > MIN_TRAVEL:
            return True
    return False
