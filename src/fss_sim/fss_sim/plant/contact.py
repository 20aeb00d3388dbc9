"""Contact between bodies: its location, and the impulses that keep the bodies apart.

Everything that moves is a chain of bodies. A body carries parts: discs, and lines with a radius.
Where two parts touch, with the normal n from the second to the first and the relative velocity J v,

    v_after = v + H^-1 J' impulse

Along the normal, impulse >= 0 and J v_after >= goal, and at least one of them is an equality.
Bodies that meet faster than a threshold bounce with Newton's restitution. Slower ones come to rest
against each other. Along the surface, bodies stick if Coulomb's friction allows it; otherwise they
slip. The rows are solved in turn until nothing changes (projected Gauss-Seidel). Restitution at
several places at once, with friction, can create energy (Kane & Levinson 1985). All goals above 0
are then scaled down by one factor until it does not.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.centroidal import scaled
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import body_reach, cross, dot
from fss_arm_model.layout import LINK_SIZE, MOUNT_ANGLE, OFFSET
from fss_arm_model.settings import NOT_NEGATIVE, Settings, between, setting


@dataclass(frozen=True)
class Contact(Settings):
    """Parameters of the law of contact between bodies."""

    restitution: float = setting(
        0.3,
        "coefficient of restitution: ratio of the speeds after and before an impact",
        check=between(0, 1),
    )
    friction: float = setting(
        0.2, "coefficient of the Coulomb friction between bodies that touch", check=NOT_NEGATIVE
    )
    threshold: float = setting(
        0.005, "impact speed below which bodies do not bounce", unit="m/s", check=NOT_NEGATIVE
    )


class Part(NamedTuple):
    """Part of a body that can touch others: all points within a radius of a line or of a point."""

    name: str
    body: int  # index in its chain
    start: complex  # in the body's frame [m]
    end: complex
    radius: float  # [m]
    inner: bool = True  # can touch parts of its own chain, except neighbours
    outer: bool = True  # can touch parts of other chains
    gripper: bool = False
    held: bool = False  # True for a target that the chain's gripper holds


# Columns of the kernels' tables of chains and of parts.
P, Q, COUNT = range(3)
CHAIN, BODY, START_X, START_Y, END_X, END_Y, RADIUS = range(7)
# Columns of a touch.
GAP, AT_X, AT_Y, NORMAL_X, NORMAL_Y = range(5)
FEATURES = 4  # possible touches of a pair: each end of either line with the other line
_SHAPE = np.empty((FEATURES, NORMAL_Y + 1))


@helper
def _frames(p, q, chains, r, u):  # type: ignore[no-untyped-def]
    """Write each body's pivot to r and its direction to u, (chains, bodies)."""
    for c in range(chains.shape[0]):
        at, of = int(chains[c, P]), int(chains[c, Q])
        numbers = p[at : at + LINK_SIZE * int(chains[c, COUNT]) + LINK_SIZE + 2]
        heading = q[of + 2]
        r[c, 0], u[c, 0] = complex(q[of], q[of + 1]), complex(math.cos(heading), math.sin(heading))
        for k in range(1, int(chains[c, COUNT]) + 1):
            r[c, k] = r[c, k - 1] + body_reach(numbers, k - 1) * u[c, k - 1]
            heading += numbers[LINK_SIZE * k + OFFSET] + q[of + 2 + k]
            if k == 1:
                heading += numbers[MOUNT_ANGLE]
            u[c, k] = complex(math.cos(heading), math.sin(heading))


@helper
def _ends(part, r, u):  # type: ignore[no-untyped-def]
    c, k = int(part[CHAIN]), int(part[BODY])
    start, end = complex(part[START_X], part[START_Y]), complex(part[END_X], part[END_Y])
    return r[c, k] + start * u[c, k], r[c, k] + end * u[c, k]


@helper
def _velocity(part, chains, r, v, x):  # type: ignore[no-untyped-def]
    """Return the velocity of the point x as a point of the part's body."""
    c = int(part[CHAIN])
    of = int(chains[c, Q])
    velocity = complex(v[of], v[of + 1])
    for k in range(int(part[BODY]) + 1):
        velocity += 1j * v[of + 2 + k] * (x - r[c, k])
    return velocity


@helper
def _nearest(x, a, b):  # type: ignore[no-untyped-def]
    """Return the position of the point nearest to x on the line from a (0) to b (1)."""
    d = b - a
    square = dot(d, d)
    return min(max(dot(d, x - a) / max(square, 1e-300), 0.0), 1.0)


@helper
def _distance(x, a, b):  # type: ignore[no-untyped-def]
    return abs(x - a - _nearest(x, a, b) * (b - a))


@kernel("(p),(m),(m),(c,f),(s,h),(g,w)->(g,w)")
def _gaps(p, q, v, chains, parts, pairs, out):  # type: ignore[no-untyped-def]
    bodies = int(chains[:, COUNT].max()) + 1
    r, u = np.empty((2, chains.shape[0], bodies), np.complex128)
    _frames(p, q, chains, r, u)
    for g in range(pairs.shape[0]):
        i, j = parts[int(pairs[g, 0])], parts[int(pairs[g, 1])]
        a, b = _ends(i, r, u)
        c, d = _ends(j, r, u)
        apart = min(
            min(_distance(a, c, d), _distance(b, c, d)), min(_distance(c, a, b), _distance(d, a, b))
        )
        crossed = cross(b - a, c - a) * cross(b - a, d - a) < 0.0
        if crossed and cross(d - c, a - c) * cross(d - c, b - c) < 0.0:
            apart = 0.0
        out[g, 0] = apart - i[RADIUS] - j[RADIUS]
        reference = _velocity(i, chains, r, v, a)
        turning = abs(_velocity(i, chains, r, v, b) - reference)
        passing = abs(_velocity(j, chains, r, v, c) - reference)
        out[g, 1] = turning + max(passing, abs(_velocity(j, chains, r, v, d) - reference))


@kernel("(p),(m),(c,f),(s,h),(g,w),(k,t)->(g,k,t)")
def _touches(p, q, chains, parts, pairs, _kt, out):  # type: ignore[no-untyped-def]
    bodies = int(chains[:, COUNT].max()) + 1
    r, u = np.empty((2, chains.shape[0], bodies), np.complex128)
    _frames(p, q, chains, r, u)
    for g in range(pairs.shape[0]):
        i, j = parts[int(pairs[g, 0])], parts[int(pairs[g, 1])]
        a, b = _ends(i, r, u)
        c, d = _ends(j, r, u)
        for f in range(FEATURES):
            out[g, f, GAP] = np.inf
            out[g, f, AT_X], out[g, f, AT_Y], out[g, f, NORMAL_X], out[g, f, NORMAL_Y] = 0, 0, 1, 0
            if f < 2:
                x = a if f == 0 else b
                y = c + _nearest(x, c, d) * (d - c)
            else:
                y = c if f == 2 else d
                x = a + _nearest(y, a, b) * (b - a)
            if (f > 0 and a == b) or (f == 3 and c == d):
                continue  # the same as another feature
            apart = abs(x - y)
            if apart == 0.0:
                continue
            n = scaled(1.0 / apart, x - y)
            out[g, f, GAP] = apart - i[RADIUS] - j[RADIUS]
            middle = 0.5 * (x - i[RADIUS] * n + y + j[RADIUS] * n)
            out[g, f, AT_X], out[g, f, AT_Y] = middle.real, middle.imag
            out[g, f, NORMAL_X], out[g, f, NORMAL_Y] = n.real, n.imag


@kernel("(p),(m),(c,f),(s,h),(k,w),(k,t)->(k,w,m)")
def _jacobian(p, q, chains, parts, pairs, touches, out):  # type: ignore[no-untyped-def]
    bodies = int(chains[:, COUNT].max()) + 1
    r, u = np.empty((2, chains.shape[0], bodies), np.complex128)
    _frames(p, q, chains, r, u)
    out[:] = 0.0
    for k in range(pairs.shape[0]):
        x = complex(touches[k, AT_X], touches[k, AT_Y])
        n = complex(touches[k, NORMAL_X], touches[k, NORMAL_Y])
        for side in range(2):
            part, sign = parts[int(pairs[k, side])], 1.0 - 2.0 * side
            c = int(part[CHAIN])
            of = int(chains[c, Q])
            for row in range(2):
                along = sign * n if row == 0 else 1j * sign * n
                out[k, row, of] += along.real
                out[k, row, of + 1] += along.imag
                for b in range(int(part[BODY]) + 1):
                    out[k, row, of + 2 + b] += cross(x - r[c, b], along)


@helper
def _solve_rows(W, v, goals, share, friction, impulse):  # type: ignore[no-untyped-def]
    """Solve the rows in turn, with goals above 0 scaled by `share`; return the energy gained."""
    impulse[:] = 0.0
    for _ in range(5000):
        change, largest = 0.0, 0.0
        for i in range(v.size):
            if W[i, i] <= 0.0:
                continue
            velocity = v[i]
            for j in range(v.size):
                velocity += W[i, j] * impulse[j]
            if i % 2 == 0:
                goal = goals[i // 2]
                goal = share * goal if goal > 0.0 else goal
                new = max(0.0, impulse[i] + (goal - velocity) / W[i, i])
            else:
                max_friction = friction * impulse[i - 1]
                new = impulse[i] - velocity / W[i, i]
                new = min(max(new, -max_friction), max_friction)
            change = max(change, abs(new - impulse[i]))
            largest = max(largest, abs(new))
            impulse[i] = new
        if change <= 1e-13 * largest:
            break
    gained = 0.0
    for i in range(v.size):
        after = 0.0
        for j in range(v.size):
            after += W[i, j] * impulse[j]
        gained += impulse[i] * (v[i] + 0.5 * after)
    return gained


@kernel("(r,r),(r),(c),(s)->(r)")
def _impulses(W, v, goals, friction, out):  # type: ignore[no-untyped-def]
    low, high = 0.0, 1.0
    gained = _solve_rows(W, v, goals, 1.0, friction[0], out)
    if gained > 0.0:
        for _ in range(20):
            share = 0.5 * (low + high)
            if _solve_rows(W, v, goals, share, friction[0], out) > 0.0:
                high = share
            else:
                low = share
        gained = _solve_rows(W, v, goals, low, friction[0], out)
    if gained > 0.0:  # by rounding, or where the rows did not settle
        out[:] = 0.0


class Scene:
    """Parts of several chains, and the pairs of them that can touch.

    Args:
        p: parameters of each chain, (8 + 6 n,) as Arm.vector().
        parts: parts of each chain.
        rigid: pairs of chains whose last bodies do not move relative to each other.
    """

    def __init__(
        self,
        p: Sequence[Floats],
        parts: Sequence[Sequence[Part]],
        rigid: Collection[frozenset[int]] = (),
    ) -> None:
        self.p, counts = np.concatenate(p), [layout.count(one) for one in p]
        starts = np.cumsum([(0, 0), *((one.size, 3 + layout.count(one)) for one in p)], axis=0)
        self.slices = [slice(a, b) for a, b in pairwise(starts[:, 1].tolist())]
        self._chains = np.column_stack([starts[:-1], counts]).astype(float)
        every = [(c, part) for c, row in enumerate(parts) for part in row]
        rows = [
            (c, x.body, x.start.real, x.start.imag, x.end.real, x.end.imag, x.radius)
            for c, x in every
        ]
        self._parts = np.array(rows).reshape(-1, RADIUS + 1)

        def can_touch(c: int, a: Part, d: int, b: Part) -> bool:
            if c == d and not (a.held or b.held):
                return a.inner and b.inner and abs(a.body - b.body) > 1
            if c == d:
                return a.outer and b.outer and a.body != b.body
            last = a.body == counts[c] and b.body == counts[d] and frozenset((c, d)) in rigid
            return a.outer and b.outer and not ((a.gripper and b.gripper) or last)

        pairs = [
            (i, j) for i, j in combinations(range(len(every)), 2) if can_touch(*every[i], *every[j])
        ]
        self.names = [(every[i][1].name, every[j][1].name) for i, j in pairs]
        self.pairs = np.array(pairs, dtype=float).reshape(-1, 2)

    def gaps(self, q: Floats, v: Floats) -> Floats:
        """Return each pair's gap [m], and an upper bound of its closing speed [m/s], (g, 2)."""
        if not self.names:
            return np.empty((0, 2))
        gaps: Floats = _gaps(self.p, q, v, self._chains, self._parts, self.pairs)
        return gaps

    def touches(self, q: Floats, pairs: Floats) -> Floats:
        """Return the nearest points of some pairs, (g, 4, 5): gap, point, normal.

        Two lines can touch at up to four places: each end of either with the other. The point is in
        the middle of the gap. The normal points from the second part to the first. The gap is
        infinite where a pair has no such place.
        """
        if not len(pairs):
            return np.empty((0, *_SHAPE.shape))
        touches: Floats = _touches(self.p, q, self._chains, self._parts, pairs, _SHAPE)
        return touches

    def jacobian(self, q: Floats, pairs: Floats, touches: Floats) -> Floats:
        """Return the Jacobian (2 k, m) of the first part's velocity relative to the second.

        Its rows are along the normal and along the surface of each touch.
        """
        rows = _jacobian(self.p, q, self._chains, self._parts, pairs, touches)
        return rows.reshape(2 * len(pairs), q.size)


def impulses(W: Floats, v: Floats, goals: Floats, friction: float) -> Floats:
    """Return the impulses along normals and surfaces, (2 k,) [N s], of k simultaneous contacts.

    Args:
        W: (2 k, 2 k) J H^-1 J'.
        v: (2 k,) J v before the impulses [m/s].
        goals: (k,) least J v along the normals after the impulses [m/s].
        friction: Coulomb's coefficient.

    Returns:
        Impulses that reach the goals. If these would add energy, the goals above 0 are scaled down.
    """
    out: Floats = _impulses(W, v, goals, np.array([friction]))
    return out
