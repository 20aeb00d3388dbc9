"""Fixed vehicle workspace: points that the tip reaches while the base holds its pose (Fig. 6).

The region is computed joint by joint from the tip inwards. The points W_k that links k .. n reach,
seen from joint k, are those of the outer links, W_{k+1}, moved to the end of link k and turned
through the range of joint k,

    W_k = union of R(alpha) (a_k + W_{k+1}),   alpha from q_min,k + theta_0k to q_max,k + theta_0k

Its boundary consists of the boundary of W_{k+1} turned to either end of the range, and of arcs
about joint k through the corners of that boundary and through its points nearest to and farthest
from the joint. All of these are circular arcs. So the boundary of W_1 also consists of circular
arcs, which are found exactly.
"""

from dataclasses import replace
from math import pi

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_workspace.regions.arcs import TOLERANCE, Arcs, Region, concatenate, crossings, enclose

FULL_TURN = 2.0 * pi


def joint_limits(arm: Arm, *, of_true_angle: bool = False) -> Floats:
    """Return the lowest and highest reading of each joint, (n, 2) [rad].

    Args:
        arm: arm with the limits q_min and q_max.
        of_true_angle: the limits hold for q + theta_0, and not for the encoder's reading q.
    """
    limits = np.array([(link.q_min, link.q_max) for link in arm.links])
    if of_true_angle:
        limits -= np.array([[link.theta_0] for link in arm.links])
    return limits


def fixed_workspace(arm: Arm, limits: npt.ArrayLike | None = None) -> Region:
    """Return the points that the tip reaches, in the base's frame [m].

    Args:
        arm: arm with lengths, offsets and mount.
        limits: lowest and highest reading of each joint, (n, 2) [rad]; the arm's by default. A
            joint whose range is a whole turn has no limits.

    Returns:
        The region and its exact boundary, holes included. With a single joint that is a curve
        without width.

    Raises:
        ValueError: limits have the wrong shape or order, or are not finite.
    """
    x, y, heading = arm.base.mount
    lengths = [link.a for link in arm.links]
    offsets = [link.theta_0 for link in arm.links]
    offsets[0] += heading
    return chain_workspace(complex(x, y), lengths, offsets, checked_limits(arm, limits))


def checked_limits(arm: Arm, limits: npt.ArrayLike | None) -> Floats:
    """Return the limits, (n, 2) [rad], the arm's by default.

    Raises:
        ValueError: the limits have the wrong shape or order, or are not finite.
    """
    if limits is None:
        return joint_limits(arm)
    checked = np.asarray(limits, dtype=float)
    if checked.shape != (arm.n, 2) or not (checked[:, 0] < checked[:, 1]).all():
        raise ValueError(f"limits are {checked.tolist()}, expected {arm.n} pairs (lowest, highest)")
    if not np.isfinite(checked).all():
        raise ValueError(f"limits are {checked.tolist()}, expected finite angles")
    return checked


def chain_workspace(
    root: complex, lengths: npt.ArrayLike, offsets: npt.ArrayLike, limits: Floats
) -> Region:
    """Return the points that the end of a chain of n revolute joints reaches.

    Args:
        root: position of joint 1 [m].
        lengths: lengths of the links, (n,) [m].
        offsets: true angle of each joint at reading 0, (n,) [rad].
        limits: lowest and highest readings, (n, 2) [rad].
    """
    a, theta_0 = np.asarray(lengths, dtype=float), np.asarray(offsets, dtype=float)
    span = np.minimum(limits[:, 1] - limits[:, 0], FULL_TURN)
    low = limits[:, 0] + theta_0
    n = len(a)
    q = np.zeros((1, n))
    q[0, -1] = limits[-1, 0]
    arc = Arcs(np.zeros(1, complex), a[-1:], low[-1:], span[-1:], np.array([n - 1]), q)
    region = _curve(arc)
    for k in range(n - 2, -1, -1):
        region = _sweep_joint(region, k, a[k], low[k], span[k], limits[k, 0])
    return Region(region.arcs.transformed(by=root), region.loop)


def _curve(arc: Arcs) -> Region:
    """Return an arc as a region without width: along it and back."""
    t = np.array([0.0, 0.5, 1.0, 0.5, 0.0])
    curve = concatenate([arc.part(t[i : i + 1], t[i + 1 : i + 2]) for i in range(4)])
    return Region(curve, np.zeros(4, dtype=np.intp))


def _sweep_joint(
    outer: Region, k: int, length: float, low: float, span: float, q_low: float
) -> Region:
    """Return W_k: W_{k+1} at the end of link k, turned about joint k.

    The joint's true angle runs from low to low + span [rad]; q_low is its reading at `low` [rad].
    """
    arcs = outer.arcs.transformed(by=length)
    at_end = Region(arcs, outer.loop)

    def inside(points: Complexes) -> npt.NDArray[np.bool_]:
        """Return True for points of W_k: turned back about joint k, they meet W_{k+1}.

        Turning back by low + span to low draws an arc. It starts inside W_{k+1}, or crosses its
        boundary.
        """
        first = points * np.exp(-1j * (low + span))
        back = Arcs(
            np.zeros(len(first), complex),
            np.abs(first),
            np.angle(first),
            np.full(len(first), span),
            np.zeros(len(first), int),
            np.zeros((len(first), 0)),
        )
        found = at_end.contains(first)
        rest = np.flatnonzero(~found)
        found[rest] = _any_crossing(back[rest], arcs)
        return found

    candidates = [_circles(arcs, k, low, span, q_low)]
    if span < FULL_TURN:
        candidates += [
            _with_reading(arcs.transformed(low), k, q_low),
            _with_reading(arcs.transformed(low + span), k, q_low + span),
        ]
    return enclose(concatenate(candidates), inside)


def _with_reading(arcs: Arcs, k: int, reading: float) -> Arcs:
    """Return the arcs with joint k at a reading [rad]."""
    q = arcs.q.copy()
    q[:, k] = reading
    return replace(arcs, q=q)


def _circles(arcs: Arcs, k: int, low: float, span: float, q_low: float) -> Arcs:
    """Return arcs about the origin, joint k, through the ends and extreme points of the arcs."""
    # An arc is farthest from joint k in the direction of its centre, and nearest in the opposite
    # one, unless these are beyond its ends. `along` is 0 at its start and 1 at its end.
    angle = np.angle(arcs.center)[None] + np.array([[0.0], [pi]])
    along = (np.sign(arcs.sweep) * (angle - arcs.start)) % FULL_TURN / np.abs(arcs.sweep)
    extreme = (along < 1.0) & (np.abs(arcs.center) > TOLERANCE)
    ends = np.stack([np.zeros(len(arcs)), np.ones(len(arcs))])
    t = np.concatenate([ends, along])
    chosen = np.concatenate([np.ones_like(extreme), extreme])
    index = np.nonzero(chosen)[1]
    touched = arcs[index]
    point, posture = touched.at(t[chosen]), touched.posture(t[chosen])
    posture[:, k] = q_low
    count = len(index)
    return Arcs(
        np.zeros(count, complex),
        np.abs(point),
        np.angle(point) + low,
        np.full(count, span),
        np.full(count, k),
        posture,
    )


def _any_crossing(some: Arcs, others: Arcs) -> npt.NDArray[np.bool_]:
    """Return True for each of the arcs (m,) that meets any of the others (k,)."""
    crosses = np.zeros(len(some), dtype=bool)
    for point in crossings(
        some.center[:, None], some.radius[:, None], others.center, others.radius
    ):
        from_others = others.covers(np.angle(point - others.center))
        from_some = some.covers(np.angle(point - some.center[:, None]).T).T
        crosses |= (np.isfinite(point) & from_others & from_some).any(axis=1)
    return crosses
