"""How well the tip can be moved: measure, ellipsoid, and maps of the best posture.

    w = sqrt(det(J J^T)) = product of J's singular values             (Yoshikawa 1985)

J (r, n) are the first r rows of the tip's Jacobian: 2 for its position, 3 for its pose. On a fixed
base that is J_m, on a floating one without momentum the generalized Jacobian J* (Umetani and
Yoshida 1989).
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base, tip_jacobian
from fss_arm_model.manipulability import (
    FIXED,
    FIXED_POSE,
    FLOATING,
    FLOATING_POSE,
    climb,
)
from fss_arm_model.momentum import generalized_jacobian

from .arcs import Complexes, Floats, Region
from .fixed import checked_limits, fixed_workspace

__all__ = [
    "FIXED",
    "FIXED_POSE",
    "FLOATING",
    "FLOATING_POSE",
    "Ellipsoid",
    "Grid",
    "Map",
    "Search",
    "ellipsoid",
    "jacobian",
    "manipulability_map",
    "measure",
]


def jacobian(arm: Arm, q_m: npt.ArrayLike, kind: npt.ArrayLike = FIXED) -> Floats:
    """J of the kind, in axes of the base's frame, (..., r, n).

    Raises:
        ValueError: shapes do not fit.
    """
    q_m = np.asarray(q_m, dtype=float)
    q = np.concatenate([np.zeros((*q_m.shape[:-1], 3)), q_m], axis=-1)
    floating, rows = np.asarray(kind)
    p = arm.vector()
    J = generalized_jacobian(p, q) if floating else tip_jacobian(p, q)[..., 3:]
    return J[..., : int(rows), :]


def measure(arm: Arm, q_m: npt.ArrayLike, kind: npt.ArrayLike = FIXED) -> Floats:
    """Manipulability w of postures (..., n), (...) [m^2 for the position, m^2 rad for the pose].

    Raises:
        ValueError: shapes do not fit.
    """
    J = jacobian(arm, q_m, kind)
    return np.sqrt(np.linalg.det(J @ np.swapaxes(J, -1, -2)).clip(0.0))


class Ellipsoid(NamedTuple):
    """Twists that joint rates of norm 1 produce: axes[k] radii[k], r of them, longest first."""

    radii: Floats  # (..., r) singular values of J [m, or of mixed units for the pose]
    axes: Floats  # (..., r, r) unit vectors, one a row


def ellipsoid(J: npt.ArrayLike) -> Ellipsoid:
    """The manipulability ellipsoid of J (..., r, n): v^T (J J^T)^-1 v <= 1 (Yoshikawa 1985)."""
    U, radii, _ = np.linalg.svd(np.asarray(J, dtype=float), full_matrices=False)
    return Ellipsoid(radii, np.swapaxes(U, -1, -2))


class Best(NamedTuple):
    """The largest manipulability at points, and how to get it; NaN where they cannot be reached."""

    w: Floats  # (m,)
    q: Floats  # (m, n) joint readings [rad]


class Search:
    """Finds the posture of largest w at any point, over all postures that reach it.

    Random postures are the first guesses at a coarse grid of points; each climbs to a local
    maximum. Then each point tries its neighbours' postures, until none gains: whatever branch is
    the best somewhere and was found at one point only spreads as far as it is the best. Any other
    point begins from the coarse points next to it.
    """

    def __init__(
        self,
        arm: Arm,
        kind: npt.ArrayLike = FIXED,
        limits: npt.ArrayLike | None = None,
        *,
        spacing: float = 0.04,
        workers: int = 1,
        seed: int = 0,
    ) -> None:
        """Solve the coarse grid.

        Args:
            arm: the arm.
            kind: what is measured.
            limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
            spacing: of the coarse grid [m].
            workers: threads to use.
            seed: of the random postures.

        Raises:
            ValueError: limits have the wrong shape or order, or the arm has a single link.
        """
        if arm.n < 2:
            raise ValueError(f"the arm has {arm.n} link, expected 2 or more: its w is 0 everywhere")
        self.arm, self.p, self.kind = arm, arm.vector(), np.asarray(kind, dtype=float)
        self.limits, self.workers = checked_limits(arm, limits), workers
        self.region = fixed_workspace(arm, self.limits)
        inner = Grid.around(self.region, spacing).inside(self.region)
        edge = [np.concatenate(part) for part in zip(*self.region.outlines(spacing), strict=True)]
        points = np.concatenate([_pairs(inner), _pairs(edge[0])])
        first = self._first(points, edge[1], np.random.default_rng(seed))
        self.tree = cKDTree(points)
        self.coarse = self._exchange(points, first)

    def at(self, points: npt.ArrayLike) -> Best:
        """The best postures at points (m, 2) of the base's frame [m]."""
        points = np.asarray(points, dtype=float)
        seeds = [*self.coarse.q[_nearest(self.tree, points, 4)].swapaxes(0, 1)]
        if self.arm.n <= 3 or self.kind[1] == 3.0:
            # Where a branch can be so small that the grid misses it: try what reaches close by.
            seeds += [*self.random[_nearest(self.random_tree, points, 8)].swapaxes(0, 1)]
        best = _nothing(len(points), self.p)
        guesses = [self._climb(seed, points, steps=0) for seed in seeds]
        order = np.argsort([-np.nan_to_num(guess.w, nan=-1.0) for guess in guesses], axis=0)
        rows = np.arange(len(points))
        for rank in order:
            guess = Best(*(np.stack(part)[rank, rows] for part in zip(*guesses, strict=True)))
            # A guess may lie this far below the maximum that it leads to.
            hopeful = ~(guess.w < 0.5 * best.w) & _differ(guess.q, best.q)
            best = self._improved(best, guess.q, points, hopeful)
        return best

    def _first(self, points: Floats, edge: Floats, rng: np.random.Generator) -> Best:
        """Each point from its nearest random postures; those of the edge from their own, too."""
        count = 40 * len(points)
        q = rng.uniform(self.limits[:, 0], self.limits[:, 1], (count, len(self.limits)))
        w, tip = measure(self.arm, q, self.kind), tip_in_base(self.p, q)[:, :2]
        self.random, self.random_tree = q, cKDTree(tip)
        near = _nearest(self.random_tree, points, 16)
        best = _nothing(len(points), self.p)
        order = np.argsort(-w[near], axis=1)[:, :3]
        for k in range(order.shape[1]):
            chosen = near[np.arange(len(points)), order[:, k]]
            best = self._improved(best, q[chosen], points, _differ(q[chosen], best.q))
        at_edge = np.arange(len(points)) >= len(points) - len(edge)
        own = np.zeros_like(best.q)
        own[at_edge] = edge
        return self._improved(best, own, points, at_edge)

    def _exchange(self, points: Floats, best: Best) -> Best:
        """Let each point try its neighbours' postures until none gains."""
        near = _nearest(self.tree, points, 9)[:, 1:]
        changed = np.ones(len(points), dtype=bool)
        while changed.any():
            before = best.w
            for neighbour in near.T:
                guess = best.q[neighbour]
                best = self._improved(
                    best, guess, points, changed[neighbour] & _differ(guess, best.q)
                )
            changed = ~(best.w <= before * (1.0 + 1e-9)) & np.isfinite(best.w)
        return best

    def _improved(
        self, best: Best, guess: Floats, points: Floats, where: npt.NDArray[np.bool_]
    ) -> Best:
        """The better of what is known and what climbing from a guess finds, where asked."""
        index = np.flatnonzero(where & np.isfinite(guess).all(axis=1))
        new = self._climb(guess[index], points[index])
        gains = ~(new.w <= best.w[index]) & np.isfinite(new.w)
        w, q = best.w.copy(), best.q.copy()
        w[index[gains]], q[index[gains]] = new.w[gains], new.q[gains]
        return Best(w, q)

    def _climb(self, guess: Floats, points: Floats, steps: int = 100) -> Best:
        def part(index: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
            return climb(self.p, guess[index], points[index], self.limits, self.kind, steps)

        q, w = _in_parts(part, len(points), self.workers)
        return Best(w, q)


def _nearest(tree: cKDTree, points: Floats, count: int) -> npt.NDArray[np.intp]:
    """Indices of the points of a tree next to each of some, (m, count), or all if it has fewer."""
    return np.asarray(tree.query(points, k=np.arange(1, min(count, tree.n) + 1))[1])


def _in_parts(
    work: Callable[[npt.NDArray[np.intp]], tuple[Floats, Floats]], count: int, workers: int
) -> tuple[Floats, Floats]:
    """What `work` makes of the indices 0 .. count - 1, by several threads."""
    index = np.arange(count)
    if workers == 1:
        return work(index)
    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, np.array_split(index, 4 * workers)))
    first, second = zip(*parts, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _nothing(count: int, p: Floats) -> Best:
    n = (p.size - 8) // 6
    return Best(np.full(count, np.nan), np.full((count, n), np.nan))


def _differ(q: Floats, other: Floats) -> npt.NDArray[np.bool_]:
    """Which postures (m, n) are not neighbours of the others, on the same branch."""
    return ~(np.abs(q - other).max(axis=1) < 0.1)


def _pairs(points: Complexes) -> Floats:
    return np.stack([points.real, points.imag], axis=-1)


@dataclass(frozen=True)
class Grid:
    """Square cells side by side, whose values belong to their centres."""

    x: float  # of the first cell's corner [m]
    y: float
    cell: float  # [m]
    width: int
    height: int

    @classmethod
    def around(cls, region: Region, cell: float) -> "Grid":
        """The cells that cover a region; the origin is a corner of some."""
        edge = np.concatenate([points for points, _ in region.outlines(cell)])
        low = np.floor(np.array([edge.real.min(), edge.imag.min()]) / cell).astype(int)
        high = np.ceil(np.array([edge.real.max(), edge.imag.max()]) / cell).astype(int)
        width, height = (high - low).tolist()
        return cls(low[0] * cell, low[1] * cell, cell, width, height)

    @property
    def centers(self) -> Complexes:
        """(height, width) [m]."""
        x = self.x + self.cell * (np.arange(self.width) + 0.5)
        y = self.y + self.cell * (np.arange(self.height) + 0.5)
        return x + 1j * y[:, None]

    def inside(self, region: Region) -> Complexes:
        """The centres that lie in a region, (m,) [m]."""
        centers = self.centers
        return centers[region.contains(centers)]


@dataclass(frozen=True)
class Map:
    """The largest manipulability in each cell of a grid; NaN in cells that cannot be reached."""

    kind: Floats  # (2,) what is measured
    grid: Grid
    region: Region  # the fixed vehicle workspace
    w: Floats  # (height, width)
    q: Floats  # (height, width, n) the postures that have it [rad]


def manipulability_map(
    arm: Arm,
    kind: npt.ArrayLike = FIXED,
    limits: npt.ArrayLike | None = None,
    *,
    cell: float = 0.01,
    workers: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> Map:
    """The map of the largest manipulability over the fixed vehicle workspace (Fig. 6).

    Args:
        arm: the arm.
        kind: what is measured.
        limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
        cell: size of a cell [m].
        workers: threads to use.
        progress: told the share that is done, now and then; what it raises ends the work.

    Raises:
        ValueError: limits have the wrong shape or order, the arm has a single link, or no cell's
            centre is reached.
    """
    search = Search(arm, kind, limits, workers=workers)
    grid = Grid.around(search.region, cell)
    centers = grid.centers
    inside = search.region.contains(centers)
    points = _pairs(centers[inside])
    parts = []
    for k, part in enumerate(np.array_split(points, max(1, len(points) // 5000))):
        progress(0.3 + 0.7 * 5000 * k / max(1, len(points)))
        parts.append(search.at(part))
    w = np.full(centers.shape, np.nan)
    q = np.full((*centers.shape, arm.n), np.nan)
    w[inside] = np.concatenate([part.w for part in parts])
    if np.isnan(w).all():
        raise ValueError(f"cell is {cell:g} m, expected small enough for a centre to be reached")
    q[inside] = np.concatenate([part.q for part in parts])
    progress(1.0)
    return Map(search.kind, grid, search.region, w, q)
