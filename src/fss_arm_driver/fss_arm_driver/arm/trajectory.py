"""Trajectory of all joints, as the links follow it: cubic between knots."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fss_arm_driver.arm.request import Code, Request, TrajectoryError
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.units import SECOND, angle_beyond, in_degrees

MIN_SEGMENT, MAX_SEGMENT = 0.002, 59.0  # between knots, as a LinkPath has them [s]
MAX_AHEAD = 119.0  # largest time until a path starts; a link allows 120 s [s]
START_REACH_TIME = 0.25  # a path starts within the distance that the drive covers in this time [s]
OVERSHOOT = 1.1  # factor on the drive's velocity, which a cubic may exceed slightly between points


@dataclass(frozen=True)
class Trajectory:
    """Timed path of all joints."""

    begin: int  # [ns]
    times: Floats  # (m,) ascending from 0 [s]
    q: Floats  # (m, n) [rad]
    qd: Floats  # (m, n) [rad/s]

    @property
    def end(self) -> int:
        """Time of the last knot [ns]."""
        return self.begin + round(self.times[-1] * SECOND)

    def at(self, time: int) -> tuple[Floats, Floats]:
        """Return positions [rad] and rates [rad/s] at a time [ns]; outside the path, at rest."""
        if not self.begin <= time < self.end:
            k = 0 if time < self.begin else -1
            return self.q[k], np.zeros_like(self.q[k])
        t = (time - self.begin) / SECOND
        k = int(np.searchsorted(self.times, t, side="right")) - 1
        h = self.times[k + 1] - self.times[k]
        s = (t - self.times[k]) / h
        c = _coefficients(h, self.q[k : k + 2], self.qd[k : k + 2])
        return c[0] + s * (c[1] + s * (c[2] + s * c[3])), (c[1] + s * (2 * c[2] + 3 * s * c[3])) / h


def check_time(request: Request, earliest: int) -> None:
    """Raise TrajectoryError if a request ends before `earliest` [ns], or starts too late."""
    if (ahead := (request.stamp - earliest) / SECOND) > MAX_AHEAD:
        words = f"starts {ahead:.1f} s ahead, expected at most {MAX_AHEAD:.0f}"
        raise TrajectoryError(Code.INVALID_GOAL, f"the trajectory {words}")
    if request.stamp and request.stamp + round(request.times[-1] * SECOND) <= earliest:
        raise TrajectoryError(Code.OLD_HEADER_TIMESTAMP, "the trajectory ends in the past")


def plan_trajectory(
    arm: Arm, request: Request, earliest: int, start: Callable[[int], tuple[Floats, Floats]]
) -> Trajectory:
    """Plan the path through the remaining points of a request, from the arm's state at its start.

    Velocities that are not given are those of the cubic spline through the points with continuous
    accelerations, and zero at the end.

    Args:
        arm: its limits.
        request: the requested trajectory.
        earliest: earliest start of the path [ns].
        start: returns q and qd, (n) each, of the arm at a time [ns].

    Raises:
        TrajectoryError: the request has ended, exceeds a limit, or starts too far away.
    """
    check_time(request, earliest)
    begin = max(request.stamp, earliest)
    times = request.times - ((begin - request.stamp) / SECOND if request.stamp else 0.0)
    q0, qd0 = start(begin)
    if times[0] == 0.0:  # the request contains the start
        _check_start(arm, request.q[0], q0)
        q, qd = request.q, request.qd.copy()
        qd[0] = np.where(np.isnan(qd[0]), qd0, qd[0])
    else:
        rows = times >= MIN_SEGMENT
        rows[-1] = True
        times = np.concatenate([[0.0], times[rows]])
        q, qd = np.vstack([q0, request.q[rows]]), np.vstack([qd0, request.qd[rows]])
    qd[-1] = np.where(np.isnan(qd[-1]), 0.0, qd[-1])
    if len(times) == 1:  # already there
        times, q, qd = np.array([0.0, MIN_SEGMENT]), np.vstack([q, q]), np.zeros((2, arm.n))
    if (shortest := np.diff(times).min()) < MIN_SEGMENT - 1e-9:
        words = f"points are {shortest:.9g} s apart, expected at least {MIN_SEGMENT} s"
        raise TrajectoryError(Code.INVALID_GOAL, words)
    found = _split_long_segments(Trajectory(begin, times, q, spline_velocities(times, q, qd)))
    _check_limits(arm, found)
    return found


def spline_velocities(times: Floats, q: Floats, qd: Floats) -> Floats:
    """Fill the NaN rows of qd, (m, n) [rad/s], so that the acceleration is continuous there.

    The first and the last row must be given. With steps h and the cubics' second derivatives
    equal on both sides of knot i,

        v_{i-1} / h_i + 2 (1 / h_i + 1 / h_{i+1}) v_i + v_{i+1} / h_{i+1}
            = 3 ((q_i - q_{i-1}) / h_i^2 + (q_{i+1} - q_i) / h_{i+1}^2),

    a tridiagonal system in which a given velocity is a row of its own.
    """
    free = np.flatnonzero(np.isnan(qd).any(axis=1))
    h = np.diff(times)
    slope = (np.diff(q, axis=0) / h[:, None] ** 2).T.tolist()
    inverse, rows = (1.0 / h).tolist(), free.tolist()
    above, pivot = [0.0] * len(times), [0.0] * len(times)
    for i in rows:  # forward elimination; a given row ends a stretch
        pivot[i] = 2.0 * (inverse[i - 1] + inverse[i]) - inverse[i - 1] * above[i - 1]
        above[i] = inverse[i] / pivot[i]
    filled = qd.T.tolist()
    for v, s in zip(filled, slope, strict=True):  # plain numbers: a tenth of the time of arrays
        for i in rows:
            v[i] = (3.0 * (s[i - 1] + s[i]) - inverse[i - 1] * v[i - 1]) / pivot[i]
        for i in reversed(rows):
            v[i] -= above[i] * v[i + 1]
    return np.array(filled).T


def _coefficients(h: Any, q: Floats, qd: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the coefficients of the cubic in s = t / h, with q and qd (2, ...) at its ends."""
    d, v0, v1 = q[1] - q[0], h * qd[0], h * qd[1]
    return q[0], v0, 3.0 * d - 2.0 * v0 - v1, v0 + v1 - 2.0 * d


def _split_long_segments(path: Trajectory) -> Trajectory:
    """Return the same path with no segment longer than the protocol allows."""
    h = np.diff(path.times)
    parts = np.ceil(h / MAX_SEGMENT).astype(int)  # of each segment
    if parts.max() == 1:
        return path
    k = np.repeat(np.arange(h.size), parts)
    s = ((np.arange(k.size) - (np.cumsum(parts) - parts)[k]) / parts[k])[:, None]
    step, ends = h[k, None], np.stack([k, k + 1])
    c0, c1, c2, c3 = _coefficients(step, path.q[ends], path.qd[ends])
    times = path.times[k] + (s * step)[:, 0]
    q = c0 + s * (c1 + s * (c2 + s * c3))
    qd = (c1 + s * (2.0 * c2 + 3.0 * s * c3)) / step
    return Trajectory(
        path.begin,
        np.append(times, path.times[-1]),
        np.vstack([q, path.q[-1]]),
        np.vstack([qd, path.qd[-1]]),
    )


def _check_start(arm: Arm, first: Floats, here: Floats) -> None:
    for i, link in enumerate(arm.links):
        reach = START_REACH_TIME * link.drive.max_velocity
        if (way := abs(first[i] - here[i])) > reach:
            raise TrajectoryError(
                Code.INVALID_GOAL,
                f"joint_{i + 1} starts {in_degrees([way])} from its present position, expected at "
                f"most {in_degrees([reach])} (or a later first point)",
            )


def _check_limits(arm: Arm, path: Trajectory) -> None:
    """Raise TrajectoryError where a joint leaves its range or is faster than its drive."""
    h = np.diff(path.times)[:, None]
    pairs = np.stack([path.q[:-1], path.q[1:]]), np.stack([path.qd[:-1], path.qd[1:]])
    c0, c1, c2, c3 = _coefficients(h, *pairs)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(c2**2 - 3.0 * c1 * c3, 0.0))
        turns = [(-c2 + root) / (3.0 * c3), (-c2 - root) / (3.0 * c3), -c1 / (2.0 * c2)]
        peak = -c2 / (3.0 * c3)
    places = [np.zeros_like(c0), np.ones_like(c0)]
    places += [np.clip(np.nan_to_num(s, posinf=0.0, neginf=0.0), 0.0, 1.0) for s in (*turns, peak)]
    s = np.stack(places)
    q = c0 + s * (c1 + s * (c2 + s * c3))
    qd = (c1 + s * (2.0 * c2 + 3.0 * s * c3)) / h
    for i, link in enumerate(arm.links):
        low, high, most = link.q_min, link.q_max, link.drive.max_velocity
        for value in (q[..., i].min(), q[..., i].max()):
            if not low - 1e-9 <= value <= high + 1e-9:
                words = f"joint_{i + 1} would be at {angle_beyond(value, low, high)}"
                raise TrajectoryError(Code.INVALID_GOAL, words)
        if (fastest := np.abs(qd[..., i]).max()) > OVERSHOOT * most:
            words = f"joint_{i + 1} would turn at {in_degrees([fastest])}/s, expected at most "
            words += f"{in_degrees([most])}/s"
            raise TrajectoryError(Code.INVALID_GOAL, words)
