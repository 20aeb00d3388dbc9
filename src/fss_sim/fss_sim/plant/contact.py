"""Contact between bodies: the parts that can touch, their gaps, and the law of impact.

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
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.centroidal import scaled
from fss_arm_model.kernels import helper, inlined
from fss_arm_model.kinematics import cross, dot
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


# Columns of the tables of parts, and of the state of a pair of parts.
CHAIN, BODY, START_X, START_Y, END_X, END_Y, RADIUS = range(7)
GAP, SPEED, OVERLAPS, PUSHED, BIAS, TREND, RATE = 0, 1, 2, 3, 4, 8, 12
FEATURES = 4  # possible touches of a pair: each end of either line with the other line
PAIR_SIZE = RATE + FEATURES


class Places(NamedTuple):
    """Places of bodies and parts in a kernel."""

    offsets: npt.NDArray[np.int64]  # (c + 1,) index of a chain's (c, psi) among those of all
    parts: Floats  # (s, 7)
    pairs: Floats  # (g, 2)
    pivots: Complexes  # (c, b) of each body of each chain
    turns: Complexes  # (c, b) exp(i psi)
    rates: Complexes  # (c, b) velocity of each pivot
    spins: Floats  # (c, b) angular velocity
    speeds: Floats  # (d,) rates of (c, psi) of all chains
    ends: Complexes  # (2, s) start and end of each part
    end_rates: Complexes  # (2, s) their velocities


@helper
def make_places(parts, pairs, counts):  # type: ignore[no-untyped-def]
    """Return Places for chains of these numbers of joints."""
    shape, kind = (counts.size, int(counts.max()) + 2), np.complex128
    ends, offsets = np.empty((2, parts.shape[0]), kind), np.zeros(counts.size + 1, np.int64)
    for c in range(counts.size):
        offsets[c + 1] = offsets[c] + 3 + int(counts[c])
    return Places(
        offsets,
        parts.copy(),
        pairs.copy(),
        np.empty(shape, kind),
        np.empty(shape, kind),
        np.empty(shape, kind),
        np.empty(shape),
        np.empty(offsets[-1]),
        ends,
        ends.copy(),
    )


@inlined
def place_bodies(chain, places, c):  # type: ignore[no-untyped-def]
    """Write the places of the bodies of chain c, and of its tip as a further pivot."""
    r, v = complex(chain.q[0], chain.q[1]), complex(chain.qd[0], chain.qd[1])
    m, mass, of = chain.held.size, chain.bodies.mass, places.offsets[c]
    places.speeds[of], places.speeds[of + 1] = chain.z[1, 0], chain.z[1, 1]
    for k in range(m):
        d = chain.vectors[1, k] + scaled(1.0 / mass, chain.vectors[2, k])
        places.pivots[c, k], places.rates[c, k] = r, v
        places.turns[c, k], places.spins[c, k] = chain.vectors[0, k], chain.z[1, 2 + k]
        places.speeds[of + 2 + k] = chain.z[1, 2 + k]
        r += d
        v += 1j * scaled(chain.z[1, 2 + k], d)
    places.pivots[c, m] = r


@helper
def place_parts(places):  # type: ignore[no-untyped-def]
    """Write the places of all parts of bodies that are in place."""
    for s in range(places.parts.shape[0]):
        part = places.parts[s]
        c, k = int(part[CHAIN]), int(part[BODY])
        for end in range(2):
            at = places.turns[c, k] * complex(part[START_X + 2 * end], part[START_Y + 2 * end])
            places.ends[end, s] = places.pivots[c, k] + at
            places.end_rates[end, s] = places.rates[c, k] + 1j * scaled(places.spins[c, k], at)


@helper
def _length(x):  # type: ignore[no-untyped-def]
    return math.sqrt(dot(x, x))


@helper
def _nearest(x, a, b):  # type: ignore[no-untyped-def]
    """Return the point of the line from a to b that is nearest to x."""
    d = b - a
    square = dot(d, d)
    return a + scaled(min(max(dot(d, x - a) / max(square, 1e-300), 0.0), 1.0), d)


@helper
def time_to_touch(gap, speed):  # type: ignore[no-untyped-def]
    """Return an estimate of the time in which a gap can close [s]."""
    return gap / (1.5 * speed + 0.05)


@helper
def measure_gaps(places, touched, horizon):  # type: ignore[no-untyped-def]
    """Write each pair's gap [m], and an upper bound of its closing speed [m/s].

    If even a lower bound of the gap cannot close within the horizon [s], this bound is written.
    """
    ends, rates = places.ends, places.end_rates
    for g in range(places.pairs.shape[0]):
        i, j = int(places.pairs[g, 0]), int(places.pairs[g, 1])
        a, b, c, d = ends[0, i], ends[1, i], ends[0, j], ends[1, j]
        turning = _length(rates[1, i] - rates[0, i])
        passing = max(_length(rates[0, j] - rates[0, i]), _length(rates[1, j] - rates[0, i]))
        touched[g, SPEED] = turning + passing
        radii = places.parts[i, RADIUS] + places.parts[j, RADIUS]
        reach = 0.5 * (_length(b - a) + _length(d - c))
        gap = 0.5 * _length(a + b - c - d) - reach - radii
        if time_to_touch(gap, touched[g, SPEED]) < horizon:
            gap = min(
                min(_length(a - _nearest(a, c, d)), _length(b - _nearest(b, c, d))),
                min(_length(c - _nearest(c, a, b)), _length(d - _nearest(d, a, b))),
            )
            crossed = cross(b - a, c - a) * cross(b - a, d - a) < 0.0
            if crossed and cross(d - c, a - c) * cross(d - c, b - c) < 0.0:
                gap = 0.0
            gap -= radii
        touched[g, GAP] = gap


@helper
def find_touch(places, g, f):  # type: ignore[no-untyped-def]
    """Return gap, middle of the gap, and normal at feature f of a pair.

    The normal points from the second part to the first. The gap is infinite if the pair has no such
    feature, or it is the same as another one.
    """
    i, j = int(places.pairs[g, 0]), int(places.pairs[g, 1])
    ends = places.ends
    a, b, c, d = ends[0, i], ends[1, i], ends[0, j], ends[1, j]
    if f < 2:
        x = a if f == 0 else b
        y = _nearest(x, c, d)
    else:
        y = c if f == 2 else d
        x = _nearest(y, a, b)
    apart = _length(x - y)
    if apart == 0.0 or (f > 0 and a == b) or (f == 3 and c == d):
        return math.inf, x, 1.0 + 0.0j
    n = scaled(1.0 / apart, x - y)
    one, other = places.parts[i, RADIUS], places.parts[j, RADIUS]
    middle = scaled(0.5, x - scaled(one, n) + y + scaled(other, n))
    return apart - one - other, middle, n


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


@helper
def solve_contacts(W, v, goals, friction, impulse):  # type: ignore[no-untyped-def]
    """Write the impulses along normals and surfaces, (2 k,) [N s], of k simultaneous contacts.

    If those that reach the goals would add energy, the goals above 0 are scaled down.

    Args:
        W: (2 k, 2 k) J H^-1 J'.
        v: (2 k,) J v before the impulses [m/s].
        goals: (k,) least J v along the normals after the impulses [m/s].
        friction: Coulomb's coefficient.
        impulse: (2 k,) result.
    """
    low, high = 0.0, 1.0
    gained = _solve_rows(W, v, goals, 1.0, friction, impulse)
    if gained > 0.0:
        for _ in range(20):
            share = 0.5 * (low + high)
            if _solve_rows(W, v, goals, share, friction, impulse) > 0.0:
                high = share
            else:
                low = share
        gained = _solve_rows(W, v, goals, low, friction, impulse)
    if gained > 0.0:  # by rounding, or where the rows did not settle
        impulse[:] = 0.0


def pair_parts(
    counts: Sequence[int],
    parts: Sequence[Sequence[Part]],
    rigid: Collection[frozenset[int]] = (),
) -> tuple[list[tuple[str, str]], Floats, Floats]:
    """Return names and indices (g, 2) of the pairs that can touch, and the parts' table (s, 7).

    Args:
        counts: number of links of each chain.
        parts: parts of each chain.
        rigid: pairs of chains whose last bodies do not move relative to each other.
    """
    every = [(c, part) for c, row in enumerate(parts) for part in row]

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
    rows = [
        (c, x.body, x.start.real, x.start.imag, x.end.real, x.end.imag, x.radius) for c, x in every
    ]
    return (
        [(every[i][1].name, every[j][1].name) for i, j in pairs],
        np.array(pairs, dtype=float).reshape(-1, 2),
        np.array(rows, dtype=float).reshape(-1, RADIUS + 1),
    )
