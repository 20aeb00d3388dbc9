"""Gaps between bodies on a path by looking everywhere, with geometry of its own.

Nothing of the guard's or of the model's clearance is used; the base's motion is that of
fss_arm_model.base_motion, a quadrature that knows no steps.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fss_arm_model.base_motion import base_poses
from fss_arm_model.description import Arm
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.joint_path import path, sampled
from fss_arm_model.momentum import momentum


@dataclass(frozen=True)
class Flight:
    """A path with what is known of base and target at its begin."""

    times: np.ndarray  # (k,)
    q: np.ndarray  # (k, n)
    qd: np.ndarray  # (k, n)
    base: np.ndarray | None = None
    twist: np.ndarray | None = None
    target: np.ndarray | None = None

    def state(self, arm: Arm, marks: np.ndarray) -> np.ndarray:
        """Of base and joints at some times, the first being that of the first knot, (m, 3 + n)."""
        law, edges = sampled([self.times] * arm.n, self.q.T, self.qd.T)
        pose = np.zeros(3) if self.base is None else self.base
        begin = np.concatenate([pose, self.q[0]])
        given = np.zeros(3)
        if self.twist is not None:
            given = momentum(arm.vector(), begin, np.concatenate([self.twist, self.qd[0]]))
        known = np.concatenate([pose, given, np.zeros(2)])
        poses = base_poses(arm.vector(), path(law, edges, marks), known)
        return np.concatenate([poses, law(marks)[0]], axis=1)


def pivots(arm: Arm, states: np.ndarray) -> list[np.ndarray]:
    """Base, joints and tip as complex numbers, (m,) each."""
    at, heading = states[:, 0] + 1j * states[:, 1], states[:, 2]
    x, y, turn = arm.base.mount
    found = [at, at + complex(x, y) * np.exp(1j * heading)]
    heading = heading + turn
    for link, angle in zip(arm.links, states[:, 3:].T, strict=True):
        heading = heading + link.theta_0 + angle
        found.append(found[-1] + link.a * np.exp(1j * heading))
    return found


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a.conj() * b).real


def apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distance of the segments ab and cd, by their closest points (Ericson 2005, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    aa, bb, ab, au, bv = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    across = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(across > 1e-15, np.clip((ab * bv - au * bb) / across, 0.0, 1.0), 0.0)
        t = np.where(bb > 0.0, (ab * s + bv) / bb, 0.0)
        t = np.clip(t, 0.0, 1.0)
        s = np.where(aa > 0.0, np.clip((ab * t - au) / aa, 0.0, 1.0), 0.0)
    return np.abs(w + s * u - t * v)


def slacks(arm: Arm, s: GuardSettings, flight: Flight, marks: np.ndarray) -> dict[str, np.ndarray]:
    """For each two bodies their gap less their margin, (m,), at some times."""
    r, n = pivots(arm, flight.state(arm, marks)), arm.n
    links = dict(enumerate(pairwise(r[1:]), 1))
    found = {}
    for i in range(2, n + 1):
        away = apart(r[0], r[0], *links[i]) - s.base_radius - s.link_radius
        found[f"link {i}, base"] = away - s.margin
        for j in range(i + 1, n + 1):
            away = apart(*links[i - 1], *links[j]) - 2.0 * s.link_radius
            found[f"link {j}, link {i - 1}"] = away - s.margin
    if flight.base is None:
        return found
    for k, point in enumerate(r):
        radius = s.link_radius if k else s.base_radius
        half = 0.5 * np.array(s.table) - radius - s.edge_margin
        inside = np.minimum(half[0] - np.abs(point.real), half[1] - np.abs(point.imag))
        found[f"table edge, {k}"] = inside
    if flight.target is None:
        return found
    rows = np.reshape(flight.target, (-1, 3))
    speed = complex(*rows[1, :2]) if len(rows) > 1 else 0j
    at = complex(*rows[0, :2]) + speed * (marks - flight.times[0])
    found["target, base"] = np.abs(at - r[0]) - s.base_radius - s.target_radius - s.margin
    grip = r[-1] + (r[-2] - r[-1]) * min(s.gripper_length / arm.links[-1].a, 1.0)
    links[n] = r[-2], grip
    for i in links:
        away = apart(at, at, *links[i]) - s.link_radius - s.target_radius
        found[f"target, link {i}"] = away - s.margin
    found["target, gripper"] = apart(at, at, grip, r[-1]) - s.target_radius + s.gripper_depth
    return found


def looks(flight: Flight, arm: Arm, s: GuardSettings, count: int = 500) -> Iterator[dict]:
    """The slacks all along, and again, more and more closely, about where each is least."""
    begin, end = flight.times[[0, -1]]
    marks, step = np.linspace(begin, end, count), (end - begin) / (count - 1)
    found = slacks(arm, s, flight, marks)
    yield found
    floor = max(0.0, min((row.min() for row in found.values() if row[0] >= 0.0), default=0.0))
    for _ in range(2):
        at = {
            t
            for row in found.values()
            if row.min() < floor + 0.05
            for t in marks[dips(row)].tolist()
        }
        if not at:
            return
        fine = np.concatenate([t + step * np.linspace(-1.0, 1.0, 21) for t in at])
        fine = np.clip(fine, begin, end)
        marks, step = np.union1d([begin], fine), 0.1 * step
        found = slacks(arm, s, flight, marks)
        yield found


def dips(row: np.ndarray) -> np.ndarray:
    """Where a sampled function has minima that may be its least, (m,) of bool."""
    ends = np.concatenate([[np.inf], row, [np.inf]])
    return (row < ends[:-2] - 1e-9) & (row <= ends[2:] + 1e-9) & (row < row.min() + 0.01)


def least(flight: Flight, arm: Arm, s: GuardSettings) -> float:
    """The least slack of any two bodies on the path that begin with their margin [m]."""
    lows: dict[str, float] = {}
    begun: dict[str, float] = {}
    for found in looks(flight, arm, s):
        begun = begun or {name: float(row[0]) for name, row in found.items()}
        for name, row in found.items():
            lows[name] = min(lows.get(name, np.inf), float(row.min()))
    return min((low for name, low in lows.items() if begun[name] >= 0.0), default=np.inf)


def shrinks(flight: Flight, arm: Arm, s: GuardSettings) -> float:
    """The most that a gap below its margin is less than it was before, to a millisecond [m].

    Infinite where one ends smaller than it began, or had its margin and loses it.
    """
    begin, end = flight.times[[0, -1]]
    marks, most = np.linspace(begin, end, int(1000.0 * (end - begin)) + 2), 0.0
    for row in slacks(arm, s, flight, marks).values():
        best = np.maximum.accumulate(row)
        most = max(most, float(np.max(best - row, where=best < 0.0, initial=0.0)))
        less = best[-1] < 0.0 and row[-1] < row[0] - 2e-6
        if less or ((best >= 0.0) & (row < 0.0)).any():
            return np.inf
    return most


def random_flight(arm: Arm, rng: np.random.Generator) -> Flight:
    """Two to five knots anywhere within the limits, and a base anywhere, with or without a target.

    The base drifts, is without momentum or is not known.
    """
    count = int(rng.integers(2, 6))
    low = np.array([link.q_min for link in arm.links])
    high = np.array([link.q_max for link in arm.links])
    q = rng.uniform(low, high, (count, arm.n))
    if rng.random() < 0.5:  # near each other
        q = q[0] + rng.uniform(0.05, 0.5) * (q - q[0])
    travel = np.abs(np.diff(q, axis=0)).max(axis=1)
    times = np.concatenate([[0.0], np.cumsum(travel / rng.uniform(0.2, 0.8) + 0.05)])
    qd = rng.normal(0.0, 0.2, q.shape)
    qd[-1] = 0.0
    if rng.random() < 0.2:
        return Flight(times, q, qd)
    base = np.array([*rng.uniform(-1.5, 1.5, 2), rng.uniform(-np.pi, np.pi)])
    twist = rng.normal(0.0, 1.0, 3) * [0.03, 0.03, 0.1] if rng.random() < 0.7 else None
    target = None
    if rng.random() < 0.4:
        target = np.array([[*rng.uniform(-1.8, 1.8, 2), 0.0], [*rng.normal(0.0, 0.03, 2), 0.0]])
    return Flight(times + rng.uniform(0.0, 5.0), q, qd, base, twist, target)
