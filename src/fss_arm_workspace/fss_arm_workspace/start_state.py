"""Measured state of arm and base, from which straight paths start."""

from collections.abc import Mapping
from math import pi, remainder
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_ros.calibrated import Calibrated


def posture(readings: Mapping[int, float], n: int) -> Floats | None:
    """Return the readings [rad] of joints 1 to n, (n,); None until all have been received."""
    joints = range(1, n + 1)
    return np.array([readings[i] for i in joints]) if all(i in readings for i in joints) else None


class PathStart(NamedTuple):
    """State from which straight paths are computed."""

    calibrated: Calibrated
    state: Floats  # (3 + n,) pose of the base, joint readings
    in_world: bool  # False: no pose of the base is known, and it is assumed to be zero

    def is_near(self, other: "PathStart | None", threshold: float) -> bool:
        """Return True if another start has the same arm, and each coordinate within a threshold."""
        if other is None or other.calibrated is not self.calibrated:
            return False
        change = self.state - other.state
        change[2] = remainder(change[2], 2.0 * pi)
        return bool((np.abs(change) <= threshold).all())
