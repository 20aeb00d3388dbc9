"""Uncertainty of a workspace: a calibration's covariance propagated to boundary, R and w.

For a number f of the arm's parameters p with covariance C, to first order,

    sigma_f^2 = (df/dp) C (df/dp)^T

A point of the boundary belongs to a posture in which no joint moves the tip outwards. So the
boundary moves, to first order, by the motion of that posture's tip along the normal. The largest w
at a point changes as w does in its posture, adapted so that the tip stays at the point.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.layout import OFFSET, each
from fss_arm_workspace.manipulability.climb import climb
from fss_arm_workspace.manipulability.measure import Kind
from fss_arm_workspace.manipulability.search import Best
from fss_arm_workspace.regions.arcs import Region
from fss_arm_workspace.regions.virtual import virtual_links

_PARAMETER_STEP = 1e-6  # step of a parameter for central differences


def deviation(
    function: Callable[[Floats], npt.ArrayLike], arm: Arm, covariance: npt.ArrayLike
) -> Floats:
    """Return the standard deviation of function(Arm.vector()), which may be an array.

    Args:
        function: function of the parameters (8 + 6 n,), differentiated by central differences
            along the covariance's eigenvectors.
        arm: arm at whose parameters to differentiate.
        covariance: covariance of Arm.vector(), (8 + 6 n, 8 + 6 n).
    """
    p = arm.vector()
    variances, directions = np.linalg.eigh(np.asarray(covariance, dtype=float))
    total = np.zeros_like(np.asarray(function(p)))
    for variance, v in zip(variances, directions.T, strict=True):
        if variance > 1e-12 * variances[-1]:
            above, below = (np.asarray(function(p + s * _PARAMETER_STEP * v)) for s in (1.0, -1.0))
            total = total + variance * ((above - below) / (2.0 * _PARAMETER_STEP)) ** 2
    return np.asarray(np.sqrt(total))


def boundary_deviation(
    arm: Arm,
    region: Region,
    covariance: npt.ArrayLike,
    spacing: float = 0.01,
    *,
    of_true_angle: bool = False,
) -> list[tuple[Complexes, Floats]]:
    """Return points of each loop of a fixed vehicle workspace, (m,) [m], and their deviations.

    Args:
        arm: the arm of the region.
        region: region from fixed_workspace.
        covariance: covariance of Arm.vector().
        spacing: maximum spacing of the points [m].
        of_true_angle: the limits hold for q + theta_0, and not for the encoder's reading q.

    Returns:
        For each loop, points and the boundary's standard deviation there along the normal [m].
    """
    lines = []
    for loop, (points, q) in zip(region.loops, region.outlines(spacing), strict=True):
        counts = np.ceil(np.abs(loop.sweep) * loop.radius / spacing).astype(int).clip(1)
        normal = points - np.repeat(loop.center, counts)
        normal /= np.abs(normal)

        def normal_position(p: Floats, q: Floats = q, normal: Complexes = normal) -> Floats:
            tip = tip_in_base(p, q + of_true_angle * _reading_changes(arm, p))
            return tip[:, 0] * normal.real + tip[:, 1] * normal.imag

        lines.append((points, deviation(normal_position, arm, covariance)))
    return lines


def _reading_changes(arm: Arm, p: Floats) -> Floats:
    """Return the changes of readings (n,) that keep q + theta_0 with p equal to the arm's [rad]."""
    return each(arm.vector() - p, OFFSET)


def radius_deviation(arm: Arm, covariance: npt.ArrayLike) -> float:
    """Return the standard deviation of R of Eq. 13 [m]."""

    def radius(p: Floats) -> Floats:
        return np.asarray(np.abs(virtual_links(p)[2]).sum())

    return float(deviation(radius, arm, covariance))


def measure_deviation(
    arm: Arm,
    best: Best,
    points: npt.ArrayLike,
    limits: Floats,
    kind: Kind,
    covariance: npt.ArrayLike,
    *,
    of_true_angle: bool = False,
) -> Floats:
    """Return the standard deviation of the largest w at points (m, 2) of the base's frame, (m,).

    Args:
        arm: the arm.
        best: postures with the largest w, from Search.at(points).
        points: x, y [m].
        limits: lowest and highest joint readings, (n, 2) [rad].
        kind: kind of measure.
        covariance: covariance of Arm.vector().
        of_true_angle: the limits hold for q + theta_0, and not for the encoder's reading q.
    """

    def largest(p: Floats) -> Floats:
        changes = of_true_angle * _reading_changes(arm, p)
        return climb(p, best.q + changes, points, limits + changes[:, None], kind)[1]

    return deviation(largest, arm, covariance)
