"""How far the bodies are from touching each other, and the table's edge."""

import numpy as np
import numpy.typing as npt

from .kernels import Floats, helper, kernel
from .kinematics import _chain, _cross, _dot, checked, joint_positions


@helper
def _to_segment(a, d, x):  # type: ignore[no-untyped-def]
    """Distance of the point x from the segment a to a + d."""
    along = min(max(_dot(d, x - a) / _dot(d, d), 0.0), 1.0)
    return abs(x - a - along * d)


@helper
def _apart(a, d, b, e):  # type: ignore[no-untyped-def]
    """Distance of the segments a to a + d and b to b + e; 0 where they cross."""
    sides = _cross(d, b - a) * _cross(d, b + e - a), _cross(e, a - b) * _cross(e, a + d - b)
    if sides[0] < 0.0 and sides[1] < 0.0:
        return 0.0
    ends = min(_to_segment(a, d, b), _to_segment(a, d, b + e))
    return min(ends, _to_segment(b, e, a), _to_segment(b, e, a + d))


@kernel("(p),(m),(),()->()")
def _clearance(p, q, base_radius, link_radius, out):  # type: ignore[no-untyped-def]
    d, e = np.empty((2, q.size - 2), np.complex128)
    _chain(p, q, d, e)
    out[0], a, first = np.inf, 0j, d[0]
    for i in range(1, d.size):
        a += d[i - 1]  # where link i begins, from the base's origin
        if i > 1:
            out[0] = min(out[0], _to_segment(a, d[i], 0j) - base_radius[0] - link_radius[0])
        b = first
        for j in range(1, i - 1):
            out[0] = min(out[0], _apart(a, d[i], b, d[j]) - 2.0 * link_radius[0])
            b += d[j]


def clearance(p: npt.ArrayLike, q: npt.ArrayLike, base_radius: float, link_radius: float) -> Floats:
    """The least gap between two bodies that are not neighbours, (...) [m]; below 0 they collide.

    The base is a disc about its origin, a link all that is within its radius of the line from its
    joint to the next. Infinite where there are no such two.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _clearance(p, q, base_radius, link_radius)


def edge_clearance(
    p: npt.ArrayLike, q: npt.ArrayLike, table: npt.ArrayLike, base: float, link: float
) -> Floats:
    """The least gap between the edge of a table about the origin and any body, (...) [m].

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q: (..., 3 + n) state.
        table: its sides along x and y [m].
        base: the base's radius [m].
        link: that of joints and tip [m].

    Raises:
        ValueError: shapes do not fit.
    """
    half, q = 0.5 * np.asarray(table), np.asarray(q, dtype=float)
    joints = half - np.abs(joint_positions(p, q)) - link
    own = half - np.abs(q[..., :2]) - base
    return np.minimum(joints.min(axis=(-1, -2)), own.min(axis=-1))
