"""Paths in joint space, as functions of time and as quadrature nodes along them."""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .arrays import Floats

_DIGITS = 12.0 * math.log(10.0)  # accuracy of a panel's quadrature


class Path(NamedTuple):
    """A path in joint space, ready for quadrature; leading dimensions are a batch of paths.

    Both start with each link's rotation relative to the base, without the encoders' offsets:
    cos Q_1, sin Q_1 .. cos Q_n, sin Q_n.
    """

    nodes: Floats  # (..., N, 3 n + 1) then the weighted rates dQ_1 .. dQ_n and dt [s]
    marks: Floats  # (..., m, 2 n + 2) then the nodes before the mark and its time t [s]


Law = Callable[[Floats], tuple[Floats, Floats]]


def path(law: Law, edges: npt.ArrayLike, marks: npt.ArrayLike) -> Path:
    """Return the nodes of a path, by Gauss-Legendre quadrature in each panel between two edges.

    For an integrand analytic up to a distance of 1 rad, m nodes on a panel in which the joints
    travel by D have an error of rho^-2m with rho = 2 / D + sqrt(4 / D^2 + 1): asinh(2 / D) per
    node and side.

    Leading dimensions of edges and marks are a batch of paths; those with fewer nodes are padded.

    Args:
        law: function of times (..., N) [s] that returns joint angles and rates, each (..., N, n)
            [rad, rad/s]; smooth between edges.
        edges: (..., e) times [s]; those before the first and after the last mark are not used.
        marks: (..., m) times [s] at which the base's pose is needed, ascending; the first is the
            start.

    Raises:
        ValueError: the marks do not ascend.
    """
    marks = np.asarray(marks, dtype=float)
    if not (np.diff(marks) >= 0.0).all():
        raise ValueError(f"marks are {marks} s, expected in ascending order")
    edges = np.clip(edges, marks[..., :1], marks[..., -1:])
    edges = np.sort(np.concatenate([edges, marks], axis=-1), axis=-1)
    begin, length = edges[..., :-1], np.diff(edges)
    probes = begin[..., None] + length[..., None] * np.linspace(0.0, 1.0, 5)
    _, rates = law(probes.reshape(*marks.shape[:-1], -1))
    travel = np.abs(rates).sum(axis=-1).reshape(probes.shape).max(axis=-1) * length
    orders = np.where(length > 0.0, _orders(travel), 0)
    before = np.sum(np.where(begin[..., None, :] < marks[..., None], orders[..., None, :], 0), -1)
    count = orders.sum(axis=-1)
    there = np.arange(np.max(count, initial=0)) < count[..., None]
    t, dt = np.where(there, 0.0, marks[..., -1:]), np.zeros(there.shape)
    x, w = _gauss_of(orders.ravel())
    dt[there] = np.repeat(length, orders.ravel()) * w
    t[there] = np.repeat(begin, orders.ravel()) + np.repeat(length, orders.ravel()) * x
    q, qd = law(t)
    rate = dt[..., None] * np.cumsum(qd, axis=-1)
    since = marks - marks[..., :1]
    return Path(
        np.concatenate([_turns(q), rate, dt[..., None]], axis=-1),
        np.concatenate([_turns(law(marks)[0]), np.stack([before, since], axis=-1)], axis=-1),
    )


def sampled(
    times: Sequence[npt.ArrayLike], q: Sequence[npt.ArrayLike], qd: Sequence[npt.ArrayLike]
) -> tuple[Law, Floats]:
    """Interpolate measured angles and rates: cubic in between (Hermite), at rest outside.

    Where acceleration is piecewise constant, as with servo drives, only the intervals in which it
    jumps are inexact.

    Args:
        times: of each joint's samples, (s_i,) [s], ascending.
        q: angles at these times [rad].
        qd: rates at these times [rad/s].

    Returns:
        The law, and as its edges the times of joints that move.
    """
    series = [
        tuple(np.asarray(part, dtype=float) for part in joint)
        for joint in zip(times, q, qd, strict=True)
    ]

    moving = [i for i, (_, q, qd) in enumerate(series) if qd.any() or np.ptp(q) > 0.0]
    resting = np.array([joint[1][0] for joint in series])

    def law(t: Floats) -> tuple[Floats, Floats]:
        angles, rates = np.tile(resting, (len(t), 1)), np.zeros((len(t), len(series)))
        for i in moving:
            angles[:, i], rates[:, i] = _hermite(t, *series[i])
        return angles, rates

    return law, np.unique(np.concatenate([[], *(series[i][0] for i in moving)]))


def _hermite(t: Floats, knots: Floats, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
    k = np.minimum(np.searchsorted(knots[1:-1], t, "right"), len(knots) - 2)
    h = knots[k + 1] - knots[k]
    x = np.maximum(np.minimum((t - knots[k]) / h, 1.0), 0.0)
    y = 1.0 - x
    slope = (q[k + 1] - q[k]) / h
    first, last = qd[k] - slope, qd[k + 1] - slope
    angle = q[k] * y + q[k + 1] * x + x * y * (y * first - x * last) * h
    rate = slope + y * (1.0 - 3.0 * x) * first + x * (3.0 * x - 2.0) * last
    return angle, np.where((t >= knots[0]) & (t <= knots[-1]), rate, 0.0)


def stack(paths: Sequence[Path]) -> Path:
    """Stack paths of the same number of links; those with fewer marks repeat their last."""
    return Path(*(_padded(arrays) for arrays in zip(*paths, strict=True)))


def _padded(arrays: Sequence[Floats]) -> Floats:
    """Stack arrays of different lengths, each padded with its last row."""
    longest = max(map(len, arrays))
    return np.array([one[np.minimum(np.arange(longest), len(one) - 1)] for one in arrays])


def _turns(q: Floats) -> Floats:
    """Return the rotations of the links at joint angles (..., n), as in a Path: (..., 2 n)."""
    Q = np.cumsum(q, axis=-1)
    return np.stack([np.cos(Q), np.sin(Q)], axis=-1).reshape(*q.shape[:-1], -1)


def _orders(travel: Floats) -> npt.NDArray[np.intp]:
    """Return the number of nodes of each panel, from the joints' travel in it [rad]."""
    nodes = np.ceil(0.5 * _DIGITS / np.arcsinh(2.0 / np.maximum(travel, 1e-6)))
    return np.where(travel > 1e-6, nodes, 1.0).astype(np.intp)


def _gauss_of(orders: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return nodes and weights on [0, 1] of panels of these orders, one after the other."""
    first = np.cumsum(orders) - orders
    x, w = np.empty((2, orders.sum()))
    for order in np.unique(orders[orders > 0]).tolist():
        at = first[orders == order, None] + np.arange(order)
        x[at], w[at] = _gauss(order)
    return x, w


@cache
def _gauss(order: int) -> tuple[Floats, Floats]:
    """Return nodes and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(order)
    return 0.5 * (x + 1.0), 0.5 * w
