"""Square cells over a region."""

from dataclasses import dataclass

import numpy as np

from fss_arm_workspace.regions.arcs import Complexes, Region


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
