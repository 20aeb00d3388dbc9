"""Circular arcs in the plane, and regions bounded by them.

While one joint turns and the others rest, the tip moves along an arc about that joint. So each arc
also stores the posture at its first point and the joint that turns. Points are complex numbers,
x + i y [m].
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from math import pi

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats

Inside = Callable[[Complexes], npt.NDArray[np.bool_]]

TOLERANCE = 1e-9  # two points, circles or arcs closer than this are the same [m]
_ANGLE_TOLERANCE = 1e-11  # an angle this far outside an arc still counts as on it [rad]
_TOUCH_TOLERANCE = 1e-13  # (half chord)^2 / (1 m^2 + r_1^2 + r_2^2) below which two circles touch
# Maximum gap between consecutive arcs of a loop [m]. Where two arcs run side by side closer than
# TOLERANCE, pieces of about sqrt(2 r TOLERANCE) may be missing; wider gaps are no rounding errors.
_MAX_GAP = 1e-3
_CHUNK_SIZE = 2**20  # maximum size of a temporary array


@dataclass(frozen=True)
class Arcs:
    """Set of k directed arcs: center + radius exp(i (start + t sweep)), t from 0 to 1."""

    center: Complexes  # (k,) [m]
    radius: Floats  # (k,) [m]
    start: Floats  # (k,) angle of the first point [rad]
    sweep: Floats  # (k,) signed angle to the last point, counter-clockwise positive [rad]
    joint: npt.NDArray[np.intp]  # (k,) index of the joint that turns by `sweep`
    q: Floats  # (k, n) joint readings at the first point [rad]

    def __len__(self) -> int:
        return len(self.radius)

    def __getitem__(self, index: npt.ArrayLike | slice) -> "Arcs":
        return Arcs(*(getattr(self, f.name)[index] for f in fields(self)))

    def at(self, t: npt.ArrayLike) -> Complexes:
        """Return the point at t (k,) of each arc, (k,)."""
        angle = self.start + np.asarray(t) * self.sweep
        return self.center + self.radius * np.exp(1j * angle)

    def posture(self, t: npt.ArrayLike) -> Floats:
        """Return the joint readings at t (k,) of each arc, (k, n) [rad]."""
        q = self.q.copy()
        q[np.arange(len(q)), self.joint] += np.asarray(t) * self.sweep
        return q

    def part(self, begin: npt.ArrayLike, end: npt.ArrayLike) -> "Arcs":
        """Return each arc from t = begin (k,) to t = end (k,), reversed where end < begin."""
        begin, end = np.asarray(begin, dtype=float), np.asarray(end, dtype=float)
        start, sweep = self.start + begin * self.sweep, (end - begin) * self.sweep
        return Arcs(self.center, self.radius, start, sweep, self.joint, self.posture(begin))

    def transformed(self, turn: float = 0.0, by: complex = 0.0) -> "Arcs":
        """Return the arcs turned about the origin by `turn` [rad], then shifted by `by` [m]."""
        center = self.center * np.exp(1j * turn) + by
        return Arcs(center, self.radius, self.start + turn, self.sweep, self.joint, self.q)

    def covers(self, angle: Floats) -> npt.NDArray[np.bool_]:
        """Return True for angles (..., k), seen from the centers, on the arcs including ends."""
        along = (np.sign(self.sweep) * (angle - self.start)) % (2.0 * pi)
        return (along <= np.abs(self.sweep) + _ANGLE_TOLERANCE) | (
            along >= 2.0 * pi - _ANGLE_TOLERANCE
        )


def concatenate(parts: list[Arcs]) -> Arcs:
    """Concatenate the arcs of all parts."""
    return Arcs(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Arcs)))


def crossings(
    c: Complexes, r: Floats, center: Complexes, radius: Floats
) -> tuple[Complexes, Complexes]:
    """Return the intersections of circles (c, r) with circles (center, radius), or NaN.

    The arguments broadcast. Circles that touch, up to rounding, have one point, returned twice;
    concentric circles have none.
    """
    between = np.asarray(center - c)
    d = np.abs(between)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (d + (r - radius) * (r + radius) / d) / 2.0
        across = (r - along) * (r + along)
        touch = _TOUCH_TOLERANCE * (1.0 + r**2 + radius**2)  # proportional to rounding errors
        across = np.sqrt(np.where(np.abs(across) < touch, 0.0, across))
        unit = np.where(d > TOLERANCE, between / d, np.nan)
        return c + unit * (along + 1j * across), c + unit * (along - 1j * across)


@dataclass(frozen=True)
class Region:
    """Region of the plane, bounded by loops of arcs that have it on their left.

    Outer boundaries run counter-clockwise, holes clockwise. A curve without width is a loop that
    runs along it and back.
    """

    arcs: Arcs  # in the order of the loops, none longer than half a circle
    loop: npt.NDArray[np.intp]  # (k,) number of the loop of each arc

    @property
    def loops(self) -> list[Arcs]:
        """Arcs of each loop."""
        return [self.arcs[self.loop == number] for number in range(self.loop.max(initial=-1) + 1)]

    @property
    def areas(self) -> list[float]:
        """Area within each loop [m^2], negative for holes, by Green's theorem on arcs.

        A = 1/2 closed integral of x dy - y dx
        """
        return [_area(loop) for loop in self.loops]

    @property
    def area(self) -> float:
        """Area [m^2] without the holes."""
        return float(sum(self.areas))

    def contains(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return True for complex points (...) inside: those that the boundary winds around."""
        z = np.asarray(points, dtype=complex)
        inside = np.zeros(z.size, dtype=bool)
        size = max(1, _CHUNK_SIZE // max(1, len(self.arcs)))
        for first in range(0, z.size, size):
            chunk = slice(first, first + size)
            inside[chunk] = self._winding(z.ravel()[chunk]) > pi
        return inside.reshape(z.shape)

    def _winding(self, z: Complexes) -> Floats:
        """Return the angle by which the boundary winds around points (m,): 2 pi inside, else 0."""
        arcs = self.arcs
        first, last = arcs.at(0.0) - z[:, None], arcs.at(1.0) - z[:, None]
        turn = np.angle(last * first.conj())
        # The arc winds by the angle of its chord, unless the point lies between the two.
        is_inside = np.abs(z[:, None] - arcs.center) < arcs.radius
        long_way = is_inside & (np.sign(turn) != np.sign(arcs.sweep))
        turn += np.where(long_way, 2.0 * pi * np.sign(arcs.sweep), 0.0)
        return np.asarray(turn.sum(axis=1))

    def distance(self, points: npt.ArrayLike) -> Floats:
        """Return the distance of complex points (...) from the boundary [m]."""
        z = np.asarray(points, dtype=complex)
        arcs, flat = self.arcs, z.ravel()
        found = np.full(z.size, np.inf)
        size = max(1, _CHUNK_SIZE // max(1, len(arcs)))
        for first in range(0, z.size, size):
            chunk = slice(first, first + size)
            p = flat[chunk, None]
            out = p - arcs.center
            margin = np.where(arcs.covers(np.angle(out)), np.abs(np.abs(out) - arcs.radius), np.inf)
            ends = np.minimum(np.abs(p - arcs.at(0.0)), np.abs(p - arcs.at(1.0)))
            found[chunk] = np.minimum(margin, ends).min(axis=1, initial=np.inf)
        return found.reshape(z.shape)

    def extent(self, point: complex) -> tuple[float, float]:
        """Return the least and greatest distance of the region from a point [m]."""
        arcs = self.arcs
        toward = np.angle(point - arcs.center)
        corners = np.abs(np.concatenate([arcs.at(0.0), arcs.at(1.0)]) - point)
        farthest_point = np.abs(arcs.center - point) + arcs.radius
        farthest = np.where(arcs.covers(toward + pi), farthest_point, 0.0).max(
            initial=corners.max()
        )
        nearest = 0.0 if self.contains(point) else self.distance(point)
        return float(nearest), float(farthest)

    def outlines(self, spacing: float) -> list[tuple[Complexes, Floats]]:
        """Return each loop as points at most `spacing` [m] apart, (m,), with postures, (m, n)."""
        lines = []
        for loop in self.loops:
            counts = np.ceil(np.abs(loop.sweep) * loop.radius / spacing).astype(int).clip(1)
            index = np.repeat(np.arange(len(loop)), counts)
            step = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
            fine, t = loop[index], step / counts[index]
            lines.append((fine.at(t), fine.posture(t)))
        return lines


def _area(loop: Arcs) -> float:
    first, last = loop.at(0.0), loop.at(1.0)
    chords = (loop.center.conj() * (last - first)).imag + loop.radius**2 * loop.sweep
    gaps = (last.conj() * np.roll(first, -1)).imag  # almost zero
    return float((chords.sum() + gaps.sum()) / 2.0)


def enclose(candidates: Arcs, inside: Inside) -> Region:
    """Return the region whose boundary is among the candidates.

    The candidates are cut where they meet. A piece bounds the region if exactly one of its two
    sides lies inside.

    Args:
        candidates: arcs that cover the boundary; they may cross, touch and coincide.
        inside: function that returns True for complex points (m,) of the region.

    Raises:
        ValueError: the boundary found does not close.
    """
    long_arcs = candidates[np.abs(candidates.sweep) * candidates.radius > TOLERANCE]
    pieces = _cut(_without_overlaps(_counter_clockwise(long_arcs)))
    pieces = pieces[pieces.sweep * pieces.radius > 2.0 * TOLERANCE]
    outward = np.exp(1j * (pieces.start + 0.5 * pieces.sweep)) * TOLERANCE
    middle = pieces.at(0.5)
    inner, outer = inside(middle - outward), inside(middle + outward)
    left_in, right_in = pieces[inner & ~outer], pieces[outer & ~inner]
    return _link_loops(concatenate([left_in, right_in.part(1.0, 0.0)]))


def _counter_clockwise(arcs: Arcs) -> Arcs:
    """Return the same arcs, each counter-clockwise."""
    back = arcs.sweep < 0.0
    return concatenate([arcs[~back], arcs[back].part(1.0, 0.0)])


def _without_overlaps(arcs: Arcs) -> Arcs:
    """Return arcs that cover the same points without overlaps."""
    same = (np.abs(arcs.center[:, None] - arcs.center) < TOLERANCE) & (
        np.abs(arcs.radius[:, None] - arcs.radius) < TOLERANCE
    )
    result, done = [], np.zeros(len(arcs), dtype=bool)
    for k in range(len(arcs)):
        if done[k]:
            continue
        circle = arcs[same[k] & ~done]
        done |= same[k]
        if len(circle) == 1:
            result.append(circle)
            continue
        ends = np.concatenate([circle.start, circle.start + circle.sweep]) % (2.0 * pi)
        cuts = np.sort(ends)
        cuts = cuts[np.append(True, np.diff(cuts) > _ANGLE_TOLERANCE)]
        lengths = np.diff(np.append(cuts, cuts[0] + 2.0 * pi))
        middle = cuts + 0.5 * lengths
        for begin, length, angle in zip(cuts, lengths, middle, strict=True):
            covering = np.flatnonzero((angle - circle.start) % (2.0 * pi) < circle.sweep)
            if covering.size and length > _ANGLE_TOLERANCE:
                arc = circle[covering[:1]]
                offset = (begin - arc.start + _ANGLE_TOLERANCE) % (2.0 * pi) - _ANGLE_TOLERANCE
                result.append(arc.part(offset / arc.sweep, (offset + length) / arc.sweep))
    return concatenate(result)


def _cut(arcs: Arcs) -> Arcs:
    """Cut the arcs where they meet one another, and halve those longer than half a circle."""
    points = crossings(arcs.center[:, None], arcs.radius[:, None], arcs.center, arcs.radius)
    angles = np.stack([np.angle(p - arcs.center[:, None]) for p in points])
    others = np.stack([np.angle(p - arcs.center) for p in points])
    meets = np.isfinite(angles) & arcs.covers(others)
    pieces = []
    for k in range(len(arcs)):
        along = (angles[:, k][meets[:, k]] - arcs.start[k]) % (2.0 * pi)
        t = np.sort(along / arcs.sweep[k])
        t = t[(t > 0.0) & (t < 1.0)]
        margin = TOLERANCE / (arcs.radius[k] * arcs.sweep[k])
        t = t[np.diff(t, prepend=0.0) > margin]
        t = np.unique(np.concatenate([[0.0], t, [1.0]]))
        halves = np.ceil(np.diff(t) * arcs.sweep[k] / pi).astype(int).clip(1)
        parts = np.repeat(np.arange(len(halves)), halves)
        share = (np.arange(len(parts)) - np.searchsorted(parts, parts)) / halves[parts]
        t = np.append(t[parts] + share * np.diff(t)[parts], 1.0)
        pieces.append(arcs[np.full(len(parts), k)].part(t[:-1], t[1:]))
    return concatenate(pieces)


def _link_loops(arcs: Arcs) -> Region:
    """Link the directed arcs to loops, and merge consecutive pieces of one arc.

    Raises:
        ValueError: a loop does not close.
    """
    first, last = arcs.at(0.0), arcs.at(1.0)
    left = np.ones(len(arcs), dtype=bool)
    order, loop, number = [], [], 0
    while left.any():
        k = begin = int(np.argmax(left))
        while left[k]:
            left[k] = False
            order.append(k)
            loop.append(number)
            gap = np.where(left, np.abs(first - last[k]), np.inf)
            gap[begin] = np.abs(first[begin] - last[k]) - TOLERANCE  # prefer to close the loop
            k = int(np.argmin(gap))
            if gap[k] > _MAX_GAP:
                raise ValueError(f"the boundary has a gap of {gap[k]:.3g} m, expected none")
        number += 1
    return _merge(Region(arcs[order], np.array(loop, dtype=np.intp)))


def _merge(region: Region) -> Region:
    """Merge consecutive arcs that continue one another, up to half a circle."""
    arcs, loop = region.arcs, region.loop
    same = (
        (loop[1:] == loop[:-1])
        & (arcs.joint[1:] == arcs.joint[:-1])
        & (np.sign(arcs.sweep[1:]) == np.sign(arcs.sweep[:-1]))
        & (np.abs(np.diff(arcs.center)) < TOLERANCE)
        & (np.abs(arcs.posture(1.0)[:-1] - arcs.q[1:]).max(axis=1, initial=0.0) < TOLERANCE)
    )
    result: list[int] = []
    sweep = arcs.sweep.copy()
    for k in range(len(arcs)):
        if k and same[k - 1] and abs(sweep[result[-1]] + sweep[k]) <= pi:
            sweep[result[-1]] += sweep[k]
        else:
            result.append(k)
    return Region(replace(arcs, sweep=sweep)[result], loop[result])
