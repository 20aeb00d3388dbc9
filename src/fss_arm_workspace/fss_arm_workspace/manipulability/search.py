"""Search for the posture of largest manipulability at any point."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_workspace.manipulability.climb import climb
from fss_arm_workspace.manipulability.measure import FIXED, Kind, measure
from fss_arm_workspace.regions.fixed import checked_limits, fixed_workspace
from fss_arm_workspace.regions.grid import Grid


class Best(NamedTuple):
    """Largest manipulability at points, and its postures; NaN at points that cannot be reached."""

    w: Floats  # (m,)
    q: Floats  # (m, n) joint readings [rad]


class Search:
    """Search for the posture of largest w at any point, over all postures that reach the point.

    Random postures are the first guesses at a coarse grid of points; each climbs to a local
    maximum. Then each point tries its neighbours' postures, until no point gains. So a branch that
    was found at one point only spreads to all points where it is the best. Any other point starts
    from the coarse points next to it.
    """

    def __init__(
        self,
        arm: Arm,
        kind: Kind = FIXED,
        limits: npt.ArrayLike | None = None,
        *,
        spacing: float = 0.04,
        workers: int = 1,
        seed: int = 0,
    ) -> None:
        """Solve the coarse grid.

        Args:
            arm: the arm.
            kind: kind of measure.
            limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
            spacing: spacing of the coarse grid [m].
            workers: threads to use.
            seed: seed of the random postures.

        Raises:
            ValueError: limits have the wrong shape or order, or the arm has a single link.
        """
        from scipy.spatial import cKDTree

        if arm.n < 2:
            raise ValueError(f"the arm has {arm.n} link, expected 2 or more: its w is 0 everywhere")
        self.arm, self.p, self.kind = arm, arm.vector(), kind
        self.limits, self.workers = checked_limits(arm, limits), workers
        self.region = fixed_workspace(arm, self.limits)
        inner = Grid.around(self.region, spacing).inside(self.region)
        edge = [np.concatenate(part) for part in zip(*self.region.outlines(spacing), strict=True)]
        points = np.concatenate([pairs(inner), pairs(edge[0])])
        first = self._first_guesses(points, edge[1], np.random.default_rng(seed))
        self.tree = cKDTree(points)
        self.coarse = self._try_neighbors(points, first)

    def at(self, points: npt.ArrayLike) -> Best:
        """Return the best postures at points (m, 2) of the base's frame [m]."""
        points = np.asarray(points, dtype=float)
        seeds = [*self.coarse.q[_nearest(self.tree, points, 4)].swapaxes(0, 1)]
        if self.arm.n <= 3 or self.kind.rows == 3.0:
            # A branch can be too small for the grid: also try random postures that reach nearby.
            seeds += [*self.random[_nearest(self.random_tree, points, 8)].swapaxes(0, 1)]
        best = _no_postures(len(points), self.p)
        guesses = [self._climb(seed, points, steps=0) for seed in seeds]
        order = np.argsort([-np.nan_to_num(guess.w, nan=-1.0) for guess in guesses], axis=0)
        rows = np.arange(len(points))
        for rank in order:
            guess = Best(*(np.stack(part)[rank, rows] for part in zip(*guesses, strict=True)))
            # A guess may have half the w of the maximum to which it leads.
            promising = ~(guess.w < 0.5 * best.w) & _differs(guess.q, best.q)
            best = self._improve(best, guess.q, points, promising)
        return best

    def _first_guesses(self, points: Floats, edge: Floats, rng: np.random.Generator) -> Best:
        """Climb at each point from its nearest random postures; at the edge also from its own."""
        from scipy.spatial import cKDTree

        count = 40 * len(points)
        q = rng.uniform(self.limits[:, 0], self.limits[:, 1], (count, len(self.limits)))
        w, tip = measure(self.arm, q, self.kind), tip_in_base(self.p, q)[:, :2]
        self.random, self.random_tree = q, cKDTree(tip)
        nearest = _nearest(self.random_tree, points, 16)
        best = _no_postures(len(points), self.p)
        order = np.argsort(-w[nearest], axis=1)[:, :3]
        for k in range(order.shape[1]):
            chosen = nearest[np.arange(len(points)), order[:, k]]
            best = self._improve(best, q[chosen], points, _differs(q[chosen], best.q))
        at_edge = np.arange(len(points)) >= len(points) - len(edge)
        edge_postures = np.zeros_like(best.q)
        edge_postures[at_edge] = edge
        return self._improve(best, edge_postures, points, at_edge)

    def _try_neighbors(self, points: Floats, best: Best) -> Best:
        """Let each point try its neighbours' postures until no point gains."""
        nearest = _nearest(self.tree, points, 9)[:, 1:]
        changed = np.ones(len(points), dtype=bool)
        while changed.any():
            before = best.w
            for neighbor in nearest.T:
                guess = best.q[neighbor]
                best = self._improve(
                    best, guess, points, changed[neighbor] & _differs(guess, best.q)
                )
            changed = ~(best.w <= before * (1.0 + 1e-9)) & np.isfinite(best.w)
        return best

    def _improve(
        self, best: Best, guess: Floats, points: Floats, where: npt.NDArray[np.bool_]
    ) -> Best:
        """Return the better of `best` and the climb from a guess, for points with `where` True."""
        index = np.flatnonzero(where & np.isfinite(guess).all(axis=1))
        new = self._climb(guess[index], points[index])
        gains = ~(new.w <= best.w[index]) & np.isfinite(new.w)
        w, q = best.w.copy(), best.q.copy()
        w[index[gains]], q[index[gains]] = new.w[gains], new.q[gains]
        return Best(w, q)

    def _climb(self, guess: Floats, points: Floats, steps: int = 100) -> Best:
        def part(index: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
            return climb(self.p, guess[index], points[index], self.limits, self.kind, steps)

        q, w = _in_threads(part, len(points), self.workers)
        return Best(w, q)


def _nearest(tree: Any, points: Floats, count: int) -> npt.NDArray[np.intp]:
    """Return indices of the tree points nearest to each point, (m, count).

    If the tree has fewer points than `count`, all are returned.
    """
    return np.asarray(tree.query(points, k=np.arange(1, min(count, tree.n) + 1))[1])


def _in_threads(
    work: Callable[[npt.NDArray[np.intp]], tuple[Floats, Floats]], count: int, workers: int
) -> tuple[Floats, Floats]:
    """Apply `work` to the indices 0 .. count - 1 in several threads, and join its results."""
    index = np.arange(count)
    if workers == 1:
        return work(index)
    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, np.array_split(index, 4 * workers)))
    first, second = zip(*parts, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _no_postures(count: int, p: Floats) -> Best:
    n = (p.size - 8) // 6
    return Best(np.full(count, np.nan), np.full((count, n), np.nan))


def _differs(q: Floats, other: Floats) -> npt.NDArray[np.bool_]:
    """Return True for postures (m, n) that are not close to the others, on the same branch."""
    return ~(np.abs(q - other).max(axis=1) < 0.1)


def pairs(points: Complexes) -> Floats:
    """Convert complex points (m,) to x, y, (m, 2)."""
    return np.stack([points.real, points.imag], axis=-1)
