"""Maps of the largest manipulability over all postures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_workspace.manipulability.measure import FIXED, Kind
from fss_arm_workspace.manipulability.search import Search, pairs
from fss_arm_workspace.regions.arcs import Region
from fss_arm_workspace.regions.grid import Grid


@dataclass(frozen=True)
class Map:
    """Largest manipulability in each cell of a grid; NaN in cells that cannot be reached."""

    kind: Kind
    grid: Grid
    region: Region  # fixed vehicle workspace
    w: Floats  # (height, width)
    q: Floats  # (height, width, n) postures with the largest w [rad]


def manipulability_map(
    arm: Arm,
    kind: Kind = FIXED,
    limits: npt.ArrayLike | None = None,
    *,
    cell: float = 0.01,
    workers: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> Map:
    """Compute the map of the largest manipulability over the fixed vehicle workspace (Fig. 6).

    Args:
        arm: the arm.
        kind: kind of measure.
        limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
        cell: size of a cell [m].
        workers: threads to use.
        progress: called regularly with the share that is done; its exceptions stop the work.

    Raises:
        ValueError: limits have the wrong shape or order, the arm has a single link, or no cell's
            centre is reached.
    """
    search = Search(arm, kind, limits, workers=workers)
    grid = Grid.around(search.region, cell)
    centers = grid.centers
    inside = search.region.contains(centers)
    points = pairs(centers[inside])
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
