"""Errors of joint readings, found from the headings of base and end effector.

The links of a planar arm turn about parallel axes, so the heading of the end effector relative to
the base is the sum of the joint angles and a constant, whatever the lengths:

    psi_tip - psi_base = q_1 + ... + q_n + constant
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fss_arm_bags.recorded import Recorded, Track, unwrap_headings
from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.planar import project_to_plane
from fss_arm_model.units import SECOND

MIN_ERROR = 0.05  # smaller disagreements with the headings are ignored [rad]
MAX_UNEXPLAINED = 0.2  # share of a disagreement that its explanation may leave
MIN_SCALE_ERROR = 0.02  # smaller differences of a ratio from 1 are ignored
MIN_FROZEN_SHARE = 0.3  # of the time in which a reading does not change
MIN_MOTION = 1e-3  # of a joint between two readings; less is rest [rad]
MIN_SAMPLES = 10


class Readings(NamedTuple):
    """Readings of all joints, and the end effector, at the stamps of the first joint."""

    stamps: Stamps  # (k,) [ns]
    q: Floats  # (k, n) [rad]
    heading: Floats  # (k,) of the end effector relative to the base, unwrapped [rad]
    tip: Floats  # (k, 2) position of the end effector along the base's axes [m]

    def seconds(self, stamps: Stamps) -> Floats:
        """Return stamps [ns] as times since the first [s]."""
        return np.asarray((stamps - self.stamps[0]) / SECOND)

    @property
    def error(self) -> Floats:
        """Disagreement (k,) of headings and readings, constant for correct readings [rad]."""
        return np.asarray(self.heading - self.q.sum(axis=1))


class ReadingError(NamedTuple):
    """Error that explains the headings."""

    words: str
    corrected: Recorded


def find_reading_errors(
    recorded: Recorded, names: Sequence[str], base: str, tip: str
) -> Iterator[ReadingError]:
    """Yield errors of readings that would explain the headings, each with the corrected recording.

    Args:
        recorded: the recording.
        names: joints, from the base.
        base: subject of the base.
        tip: subject of the end effector.
    """
    r, joints = sample_readings(recorded, names, base, tip), recorded.joints
    if r is None or _spread(r.error) < MIN_ERROR:
        return
    yield from _scales(r, recorded, names)
    for name, q in zip(names, r.q.T, strict=True):
        for words, values in (*_jump(r, joints[name], name), *_frozen(r, q, joints[name], name)):
            changed = {**joints, name: joints[name]._replace(values=values)}
            yield ReadingError(words, replace(recorded, joints=changed))


def relative_heading(base: Track, tip: Track) -> Floats:
    """Return the end effector's heading relative to the base [rad], at the base's stamps."""
    t, since = ((track.t - base.t[0]) / SECOND for track in (base, tip))
    own, other = (unwrap_headings(project_to_plane(track.values)[:, 2]) for track in (base, tip))
    return np.asarray(np.interp(t, since, other) - own)


def sample_readings(
    recorded: Recorded, names: Sequence[str], base: str, tip: str
) -> Readings | None:
    """Sample joints and poses at common times; None: too few have been recorded."""
    joints, poses = recorded.joints, recorded.poses
    if not (joints.keys() >= set(names) and poses.keys() >= {base, tip}):
        return None
    first, *_ = tracks = [*(joints[name] for name in names), poses[base], poses[tip]]
    if min(len(track.t) for track in tracks) < MIN_SAMPLES:
        return None
    begin, end = max(track.t.min() for track in tracks), min(track.t.max() for track in tracks)
    stamps = first.t[(first.t >= begin) & (first.t <= end)]
    if len(stamps) < MIN_SAMPLES:
        return None

    def sampled(track: Track, values: Floats) -> Floats:
        return np.interp((stamps - begin) / SECOND, (track.t - begin) / SECOND, values)

    q = np.column_stack([sampled(track, track.values[:, 0]) for track in tracks[:-2]])
    seen = {name: project_to_plane(poses[name].values) for name in (base, tip)}
    x, y = (
        sampled(poses[tip], seen[tip][:, k]) - sampled(poses[base], seen[base][:, k])
        for k in (0, 1)
    )
    turn = sampled(poses[base], unwrap_headings(seen[base][:, 2]))
    place = (x + 1j * y) * np.exp(-1j * turn)
    heading = sampled(poses[base], relative_heading(poses[base], poses[tip]))
    known = np.isfinite(q).all(axis=1) & np.isfinite(heading)
    if known.sum() < MIN_SAMPLES:
        return None
    place = place[known]
    return Readings(
        stamps[known], q[known], heading[known], np.column_stack([place.real, place.imag])
    )


def unwrap_readings(track: Track) -> Track:
    """Return a joint's track with readings that wrap at a full turn made continuous."""
    values = track.values.copy()
    values[:, 0] = np.unwrap(values[:, 0])
    return track._replace(values=values)


def tip_in_world(recorded: Recorded, base: str, tip: str) -> Recorded:
    """Take the end effector's poses as relative to the base; transform them to the world frame."""
    own, other = recorded.poses[base], recorded.poses[tip]
    if not len(own.t) or not len(other.t):
        return recorded
    at, seen = project_to_plane(own.values), project_to_plane(other.values)
    t, since = (track.t - own.t[0] for track in (other, own))
    columns = *at.T[:2], unwrap_headings(at[:, 2])
    x, y, heading = (np.interp(t, since, column) for column in columns)
    away = (seen[:, 0] + 1j * seen[:, 1]) * np.exp(1j * heading)
    half, none = 0.5 * (heading + seen[:, 2]), np.zeros(len(t))
    pose = [x + away.real, y + away.imag, none, none, none, np.sin(half), np.cos(half)]
    poses = {**recorded.poses, tip: other._replace(values=np.column_stack(pose))}
    return replace(recorded, poses=poses)


def _spread(values: Floats) -> float:
    low, high = np.percentile(values, [5.0, 95.0])
    return float(high - low)


def _scales(r: Readings, recorded: Recorded, names: Sequence[str]) -> Iterator[ReadingError]:
    """Yield the ratios of turns and readings, fitted to the headings, if some are not 1."""
    terms = np.column_stack([r.q, np.ones(len(r.q))])
    ratios, _, rank, _ = np.linalg.lstsq(terms, r.heading, rcond=1e-6)
    left = _spread(r.heading - terms @ ratios)
    if rank < len(ratios) or left > MAX_UNEXPLAINED * _spread(r.error):
        return
    wrong = {
        name: float(ratio)
        for name, ratio in zip(names, ratios[:-1], strict=True)
        if abs(ratio - 1.0) > MIN_SCALE_ERROR
    }
    if not wrong or all(abs(ratio + 1.0) < MIN_SCALE_ERROR for ratio in wrong.values()):
        return  # signs are tested by themselves
    found = np.array([*wrong.values()])
    words = ", ".join(
        f"{name} turns {ratio:.2g} times its reading" for name, ratio in wrong.items()
    )
    if len(wrong) == len(names) > 1 and np.ptp(found) < MIN_SCALE_ERROR:
        words = f"all joints turn {found.mean():.2g} times their readings"

    def scale(name: str, track: Track) -> Track:
        return track._replace(values=track.values * wrong.get(name, 1.0))

    yield ReadingError(f"{words}?", recorded.change(joints=scale))


def _jump(r: Readings, track: Track, name: str) -> Iterator[tuple[str, Floats]]:
    """Yield the joint's readings without a jump, if one explains the error."""
    error = r.error
    count = np.arange(1, len(error))
    before, total = np.cumsum(error)[:-1], error.sum()
    k = 1 + int(np.argmax(before**2 / count + (total - before) ** 2 / (len(error) - count)))
    step = float(np.median(error[k:]) - np.median(error[:k]))
    if _spread(error - step * (np.arange(len(error)) >= k)) > MAX_UNEXPLAINED * abs(step):
        return
    values = track.values.copy()
    values[track.t >= r.stamps[k], 0] += step
    since = r.seconds(r.stamps)[k]
    jump = np.degrees(-step)
    yield f"reading of {name} jumps by {jump:.3g} deg, {since:.0f} s after the start?", values


def _frozen(r: Readings, q: Floats, track: Track, name: str) -> Iterator[tuple[str, Floats]]:
    """Yield the joint's readings by the headings, if its own do not change while these do."""
    t, error = r.seconds(r.stamps), r.error
    edges = np.array([0, *(np.flatnonzero(np.diff(q)) + 1), len(q) - 1])
    k = int(np.argmax(np.diff(t[edges])))
    begin, end = int(edges[k]), int(edges[k + 1])
    if t[end] - t[begin] < MIN_FROZEN_SHARE * t[-1] or _spread(error[begin:end]) < MIN_ERROR:
        return
    turned = q + _without_noise(r) - np.median(error[: begin + 1])
    own = r.seconds(track.t)
    angles = np.interp(own, t, turned)
    with np.errstate(divide="ignore", invalid="ignore"):  # of stamps that were repeated
        values = np.column_stack([angles, np.gradient(angles, own)])
    yield f"reading of {name} frozen for {t[end] - t[begin]:.0f} s?", values


def _without_noise(r: Readings) -> Floats:
    """Return the error, constant while the other joints rest: noise of headings is motion."""
    moves = np.any(np.abs(np.diff(r.q, axis=0, prepend=r.q[:1])) > MIN_MOTION, axis=1)
    result = r.error.copy()
    edges = np.flatnonzero(np.diff([True, *moves, True]))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        result[begin:end] = np.median(result[begin:end])
    return result
