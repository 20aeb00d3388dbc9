"""Distances between the bodies of the arm, a target, and the table's edge.

The base is a disc about its origin. A link is the set of points within its radius of the line from
its joint to the next. The target is a disc. The gripper is the end of the last link, which may
touch the target: for the target it is a line without radius, and the rest of the last link ends
where the gripper starts. Bodies are numbered 0: the base, 1 to n: the links, then n + GRIPPER,
n + TARGET and n + EDGE.
"""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .extents import Extents
from .kernels import helper, kernel
from .kinematics import checked, cross, dot, write_chain

GRIPPER, TARGET, EDGE = 1, 2, 3

# Indices of the sizes that kernels take.
BASE_RADIUS, LINK_RADIUS, TARGET_RADIUS, GRIPPER_LENGTH, HALF_X, HALF_Y = range(6)


def sizes(extents: Extents, target_radius: float = 0.0, gripper_length: float = 0.0) -> Floats:
    """Return the sizes of all bodies and the table for the kernels, (6,) [m]."""
    half = 0.5 * np.array(extents.table)
    radii = extents.base_radius, extents.link_radius, target_radius, gripper_length
    return np.array([*radii, *half])


def links_and_base(n: int) -> Iterator[tuple[int, int]]:
    """Return the pairs of base and links that are not neighbours."""
    return ((i, j) for i in range(n + 1) for j in range(i + 2, n + 1))


def with_target(n: int) -> Iterator[tuple[int, int]]:
    """Return the pairs of the target with base, links and gripper."""
    return ((i, n + TARGET) for i in range(n + 1 + GRIPPER))


def with_edge(n: int) -> Iterator[tuple[int, int]]:
    """Return the pairs of the edge with base, links and gripper."""
    return ((i, n + EDGE) for i in range(n + 1 + GRIPPER if n else 1))


def body_name(body: int, n: int) -> str:
    """Return the name of a body for messages."""
    others = {0: "base", n + GRIPPER: "gripper", n + TARGET: "target", n + EDGE: "table edge"}
    return others.get(body, f"link {body}")


@helper
def point_distance(a, d, x):  # type: ignore[no-untyped-def]
    """Return the distance of the point x from the segment a to a + d."""
    share = min(max(dot(d, x - a) / dot(d, d), 0.0), 1.0)
    return abs(x - a - share * d)


@helper
def segment_distance(a, d, b, e):  # type: ignore[no-untyped-def]
    """Return the distance of the segments a to a + d and b to b + e; 0 where they cross."""
    sides = cross(d, b - a) * cross(d, b + e - a), cross(e, a - b) * cross(e, a + d - b)
    if sides[0] < 0.0 and sides[1] < 0.0:
        return 0.0
    ends = min(point_distance(a, d, b), point_distance(a, d, b + e))
    return min(ends, point_distance(b, e, a), point_distance(b, e, a + d))


@helper
def body_gap(i, j, r, target, sizes):  # type: ignore[no-untyped-def]
    """Return the gap between bodies i < j [m]; r (n + 2,) are the base, the joints and the tip."""
    n = r.size - 2
    last = r[n + 1] - r[n]
    if j <= n:
        if i == 0:
            reach = sizes[BASE_RADIUS] + sizes[LINK_RADIUS]
            return point_distance(r[j], r[j + 1] - r[j], r[0]) - reach
        apart = segment_distance(r[i], r[i + 1] - r[i], r[j], r[j + 1] - r[j])
        return apart - 2.0 * sizes[LINK_RADIUS]
    radius = sizes[BASE_RADIUS] if i == 0 else sizes[LINK_RADIUS]
    if j == n + EDGE:
        x, y = sizes[HALF_X] - abs(r[i].real), sizes[HALF_Y] - abs(r[i].imag)
        return min(x, y) - radius
    share = min(sizes[GRIPPER_LENGTH] / abs(last), 1.0 - 1e-9)
    if i == 0:
        return abs(target - r[0]) - radius - sizes[TARGET_RADIUS]
    if i == n + GRIPPER:
        return point_distance(r[n + 1], -(share + 1e-9) * last, target) - sizes[TARGET_RADIUS]
    rest = (1.0 - share) * last if i == n else r[i + 1] - r[i]
    return point_distance(r[i], rest, target) - radius - sizes[TARGET_RADIUS]


@helper
def _pivots(q, d, r):  # type: ignore[no-untyped-def]
    """Write the base's origin, the joints and the tip to r, from the bodies' d."""
    r[0] = complex(q[0], q[1])
    for k in range(d.size):
        r[k + 1] = r[k] + d[k]


@kernel("(p),(m),(g,w),(s),(w)->(g)")
def _gaps(p, q, pairs, sizes, target, out):  # type: ignore[no-untyped-def]
    d, e = np.empty((2, q.size - 2), np.complex128)
    r = np.empty(q.size - 1, np.complex128)
    write_chain(p, q, d, e)
    _pivots(q, d, r)
    for k in range(out.size):
        i, j = int(pairs[k, 0]), int(pairs[k, 1])
        out[k] = body_gap(i, j, r, complex(target[0], target[1]), sizes)


def gaps(
    p: npt.ArrayLike,
    q: npt.ArrayLike,
    pairs: npt.ArrayLike,
    sizes: npt.ArrayLike,
    target: npt.ArrayLike = (np.nan, np.nan),
) -> Floats:
    """Return the gap between the two bodies of each pair, (..., g) [m]; below 0 they collide.

    Two links that cross have distance 0 between their lines, however far one extends beyond.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q: (..., 3 + n) state.
        pairs: (g, 2) bodies by number, the lower first.
        sizes: (6,), from `sizes`.
        target: (..., 2) its position in the world [m]; only used by pairs with the target.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    pairs = np.asarray(pairs, dtype=float).reshape(-1, 2)
    return np.asarray(_gaps(p, q, pairs, sizes, target))


def clearance(p: npt.ArrayLike, q: npt.ArrayLike, base_radius: float, link_radius: float) -> Floats:
    """Return the least gap between bodies of base and arm that are not neighbours, (...) [m].

    Infinite if there is no such pair.

    Raises:
        ValueError: shapes do not fit.
    """
    around = sizes(Extents(base_radius=base_radius, link_radius=link_radius))
    pairs = list(links_and_base(np.shape(q)[-1] - 3))
    return np.min(gaps(p, q, pairs, around), axis=-1, initial=np.inf)


def edge_clearance(
    p: npt.ArrayLike, q: npt.ArrayLike, table: tuple[float, ...], base: float, link: float
) -> Floats:
    """Return the least gap between the edge of a table about the origin and any body, (...) [m].

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q: (..., 3 + n) state.
        table: sides of the table along x and y [m].
        base: the base's radius [m].
        link: radius of the joints and the tip [m].

    Raises:
        ValueError: shapes do not fit.
    """
    pairs = list(with_edge(np.shape(q)[-1] - 3))
    return np.min(gaps(p, q, pairs, sizes(Extents(table, base, link))), axis=-1)
