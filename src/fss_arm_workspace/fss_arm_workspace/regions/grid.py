"""Grid of square cells over a region."""

from dataclasses import dataclass

import numpy as np

from fss_arm_model.arrays import Complexes
from fss_arm_workspace.regions.arcs import Region


@dataclass(frozen=True)
class Grid:
    """Grid of square cells, whose values are those at the centres."""

    x: float  # lowest corner of the first cell [m]
    y: float
    cell: float  # [m]
    width: int
    height: int

    @classmethod
    def around(cls, region: Region, cell: float) -> "Grid":
        """Return the grid that covers a region; the origin lies on a corner of its lattice."""
        edge = np.concatenate([points for points, _ in region.outlines(cell)])
        low = np.floor(np.array([edge.real.min(), edge.imag.min()]) / cell).astype(int)
        high = np.ceil(np.array([edge.real.max(), edge.imag.max()]) / cell).astype(int)
        width, height = (high - low).tolist()
        return cls(low[0] * cell, low[1] * cell, cell, width, height)

    @property
    def centers(self) -> Complexes:
        """Centres of the cells, (height, width) [m]."""
        x = self.x + self.cell * (np.arange(self.width) + 0.5)
        y = self.y + self.cell * (np.arange(self.height) + 0.5)
        return x + 1j * y[:, None]

    def inside(self, region: Region) -> Complexes:
        """Return the centres inside a region, (m,) [m]."""
        centers = self.centers
        return centers[region.contains(centers)]
