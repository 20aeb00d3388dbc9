"""Planar poses (x [m], y [m], heading [rad]) and their angles."""

from math import atan2

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


def mean_pose(poses: Floats) -> Floats:
    """Return the mean of poses (k, 3) that differ by noise; headings are averaged on the circle."""
    heading = np.angle(np.mean(np.exp(1j * poses[:, 2])))
    return np.array([*poses[:, :2].mean(axis=0), heading])


def project_to_plane(numbers: Floats) -> Floats:
    """Project poses x, y, z [m] and quaternion x, y, z, w, (k, 7), to the plane of the table.

    Returns:
        (k, 3) x [m], y [m], heading [rad]; NaN where the subject was occluded.
    """
    x, y, z, w = numbers[:, 3:].T
    # Use math.atan2: numpy's differs from it in the last bit.
    heading = map(atan2, (2.0 * (w * z + x * y)).tolist(), (w * w + x * x - y * y - z * z).tolist())
    visible = np.isfinite(numbers).all(axis=1) & (x * x + y * y + z * z + w * w >= 0.25)
    found = np.column_stack([numbers[:, :2], np.fromiter(heading, np.float64, len(numbers))])
    return np.where(visible[:, None], found, np.nan)
