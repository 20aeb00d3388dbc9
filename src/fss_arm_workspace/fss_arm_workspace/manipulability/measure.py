"""Manipulability measure and ellipsoid of the tip.

    w = sqrt(det(J J^T)) = product of J's singular values             (Yoshikawa 1985)

J (r, n) are the first r rows of the tip's Jacobian: 2 for its position, 3 for its pose. On a fixed
base the Jacobian is J_m, on a floating base without momentum the generalized Jacobian J* (Umetani
and Yoshida 1989). w does not depend on the base's pose.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_model.kernels import helper
from fss_arm_model.kinematics import tip_jacobian
from fss_arm_model.momentum import generalized_jacobian, write_floating_jacobian


class Kind(NamedTuple):
    """Kind of measure; kernels take it as an array (2,)."""

    floating: float  # 1 if the base floats, else 0
    rows: float  # r


FIXED, FLOATING = Kind(0.0, 2.0), Kind(1.0, 2.0)
FIXED_POSE, FLOATING_POSE = Kind(0.0, 3.0), Kind(1.0, 3.0)


@helper
def fixed_jacobian(d: Complexes, J: Floats) -> complex:
    """Write J_m (3, n); return the tip's position relative to the base."""
    arm = 0j
    for k in range(d.size - 1, 0, -1):
        arm += d[k]
        J[0, k - 1], J[1, k - 1], J[2, k - 1] = -arm.imag, arm.real, 1.0
    return arm + d[0]


@helper
def square_measure(p: Floats, d: Complexes, e: Complexes, kind: Kind, J: Floats) -> float:
    """Return w^2 = det(J J^T); J (3, n) is scratch."""
    if kind.floating > 0.0:
        write_floating_jacobian(p, d, e, J)
    else:
        fixed_jacobian(d, J)
    xx = xy = yy = xz = yz = zz = 0.0
    for k in range(J.shape[1]):
        x, y, z = J[0, k], J[1, k], J[2, k]
        xx += x * x
        xy += x * y
        yy += y * y
        xz += x * z
        yz += y * z
        zz += z * z
    plane = xx * yy - xy * xy
    if kind.rows < 3.0:
        return plane
    return zz * plane - xz * (xz * yy - xy * yz) - yz * (yz * xx - xy * xz)


def jacobian(arm: Arm, q_m: npt.ArrayLike, kind: Kind = FIXED) -> Floats:
    """Return J of the kind, in axes of the base's frame, (..., r, n).

    Raises:
        ValueError: shapes do not fit.
    """
    q_m = np.asarray(q_m, dtype=float)
    q = np.concatenate([np.zeros((*q_m.shape[:-1], 3)), q_m], axis=-1)
    p = arm.vector()
    J = generalized_jacobian(p, q) if kind.floating else tip_jacobian(p, q)[..., 3:]
    return J[..., : int(kind.rows), :]


def measure(arm: Arm, q_m: npt.ArrayLike, kind: Kind = FIXED) -> Floats:
    """Return the manipulability w of postures (..., n), (...) [position: m^2, pose: m^2 rad].

    Raises:
        ValueError: shapes do not fit.
    """
    J = jacobian(arm, q_m, kind)
    return np.sqrt(np.linalg.det(J @ np.swapaxes(J, -1, -2)).clip(0.0))


class Ellipsoid(NamedTuple):
    """Ellipsoid of the twists for joint rates of norm 1: r semi-axes axes[k] radii[k].

    The longest comes first.
    """

    radii: Floats  # (..., r) singular values of J [m, or of mixed units for the pose]
    axes: Floats  # (..., r, r) unit vectors, one a row


def ellipsoid(J: npt.ArrayLike) -> Ellipsoid:
    """Return the manipulability ellipsoid of J (..., r, n): v^T (J J^T)^-1 v <= 1.

    Source: Yoshikawa (1985).
    """
    U, radii, _ = np.linalg.svd(np.asarray(J, dtype=float), full_matrices=False)
    return Ellipsoid(radii, np.swapaxes(U, -1, -2))
