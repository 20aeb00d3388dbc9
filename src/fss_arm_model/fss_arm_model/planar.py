"""Planar poses (x [m], y [m], heading [rad]) and their angles."""

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats


def wrap(angle: npt.ArrayLike) -> Floats:
    """Return the same angle [rad] in [-pi, pi)."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi


def inverse(pose: Floats) -> Floats:
    """Return the poses of A in B from those of B in A, (..., 3)."""
    away = -(pose[..., 0] + 1j * pose[..., 1]) * np.exp(-1j * pose[..., 2])
    return np.stack([away.real, away.imag, -pose[..., 2]], axis=-1)
