"""Newest readings of the joints, and the motion interpolated through them."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.joint_path import Law, Path, path, sampled

MAX_OLD_READINGS = 64  # kept beyond those requested, so that lists are rarely shortened


class Joint:
    """Newest readings of one joint, in the order of their stamps."""

    def __init__(self) -> None:
        self.t: list[int] = []  # [ns]
        self.q: list[float] = []  # [rad]
        self.qd: list[float] = []  # [rad/s]
        self.effort: list[float] = []  # [N m]

    def add(self, t: int, q: float, qd: float, effort: float) -> bool:
        """Add a reading; return False if it is not newer."""
        if self.t and t <= self.t[-1]:
            return False
        self.t.append(t)
        self.q.append(q)
        self.qd.append(qd)
        self.effort.append(effort)
        return True

    def last_index(self, t: int) -> int:
        """Return the index of the last reading at or before t [ns]; 0 if there is none."""
        return max(bisect_right(self.t, t) - 1, 0)

    def drop_before(self, t: int) -> None:
        """Drop readings older than the last one at or before `t` [ns], if they are many."""
        if (k := self.last_index(t)) > MAX_OLD_READINGS:
            for series in (self.t, self.q, self.qd, self.effort):
                del series[:k]

    def is_moving(self, t: int, threshold: float) -> bool:
        """Return True if a reading next to t [ns] is faster than `threshold` [rad/s]."""
        k = bisect_right(self.t, t)
        return any(abs(qd) > threshold for qd in self.qd[max(k - 1, 0) : k + 1])


class JointMotion(NamedTuple):
    """Motion of all joints, interpolated through their readings."""

    origin: int  # [ns]; the law's times are relative to it [s]
    law: Law
    edges: Floats

    def at(self, *times: float) -> tuple[Floats, Floats]:
        """Return angles and rates at times [ns], (m, n) each."""
        return self.law((np.array(times) - self.origin) * 1e-9)

    def path(self, start: int, end: int) -> Path:
        """Return the path between two times [ns], for quadrature."""
        marks = [(start - self.origin) * 1e-9, (end - self.origin) * 1e-9]
        return path(self.law, self.edges, marks)


def joint_motion(joints: Sequence[Joint], start: int, margin: int) -> JointMotion:
    """Return the motion from the time `start` [ns] minus `margin` [ns] to the last readings."""
    parts = [slice(joint.last_index(start - margin), None) for joint in joints]
    law, edges = sampled(
        [(np.array(j.t[k]) - start) * 1e-9 for j, k in zip(joints, parts, strict=True)],
        [np.array(j.q[k]) for j, k in zip(joints, parts, strict=True)],
        [np.array(j.qd[k]) for j, k in zip(joints, parts, strict=True)],
    )
    return JointMotion(start, law, edges)
