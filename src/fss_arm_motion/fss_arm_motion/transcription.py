"""Nonlinear program for the motion between two postures, over few knots.

A path has m knots, at rest at the first and the last one, and cubics between them (Hermite's), as
in the links. The variables are the inner knots' angles and rates and the times h_k between knots:

    minimize    w_t sum_k h_k + w_r mean(omega^2) / 2 + w_s sum(q''^2) / 2
    subject to  |q'| <= rate, |q''| <= acceleration, q_min <= q <= q_max, h_k >= least,
                |tau + viscous q'| <= torque, gap >= margin, and, if requested, int omega dt = turn

where omega is the base's rate, tau the torques of free_floating.py and gap the least one between
two bodies that are not neighbours (fss_arm_model.clearance). Limits are imposed at the five Lobatto
points of each segment; the caller must check the motion between them. As accelerations may jump at
knots whose times are free, few knots suffice where the best motion switches between limits.

This module has the limits' values and derivatives; interior_point.py solves. Each point has 4 n + 1
limited quantities: n torques, the gap, n rates, n positions, n accelerations; then the base's rate.
A segment's variables are q_0, q'_0, h, q_1, q'_1, 4 n + 1 in all.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.clearance import point_distance, segment_distance
from fss_arm_model.free_floating import write_free_torques, write_geometry
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import write_chain

POINTS = 5  # Lobatto points of a segment
_PLACES = 0.5 + 0.5 * np.array([-1.0, -math.sqrt(3.0 / 7.0), 0.0, math.sqrt(3.0 / 7.0), 1.0])
WEIGHTS = np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 180.0
_DIFFERENCE = 1e-6  # of angles and rates, for forward differences
_NO_GAP = 1e3  # larger than any gap [m]


def _basis() -> Floats:
    """Return weights of q_0, h q'_0, q_1, h q'_1 in q, h q', h^2 q'' at the points, (5, 3, 4)."""
    x = _PLACES
    value = [1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2]
    rate = [6 * x**2 - 6 * x, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x]
    gain = [12 * x - 6, 6 * x - 4, 6 - 12 * x, 6 * x - 2]
    return np.moveaxis(np.array([value, rate, gain]), 2, 0).copy()


_BASIS = _basis()


class Limited(NamedTuple):
    """The arm and its limits."""

    p: Floats  # Arm.vector()
    rotor: Floats  # (2,) N^2 J and N J
    momentum: float  # L
    bounds: Floats  # (n, 2) of angles
    limits: Floats  # (n, 4) of rates, accelerations and torques, and viscous friction
    radii: Floats  # (3,) of base and links, and the margin between bodies


class Scratch(NamedTuple):
    """Scratch memory of kernels."""

    state: Floats  # (3 + n,), as the next four
    rate: Floats
    gain: Floats
    tau: Floats
    other: Floats
    work: Complexes  # (3, n + 1)
    second: Complexes  # (2, n + 1)
    part: Floats  # (5,)


@helper
def make_scratch(n):  # type: ignore[no-untyped-def]
    """Return scratch memory for n joints."""
    state, rate, gain, tau, other = np.empty((5, 3 + n))
    work, second = np.empty((3, n + 1), np.complex128), np.empty((2, n + 1), np.complex128)
    return Scratch(state, rate, gain, tau, other, work, second, np.empty(5))


@helper
def _torques(arm, s, geometry, tau):  # type: ignore[no-untyped-def]
    """Write the torques at the scratch's state; return the base's rate."""
    return write_free_torques(
        arm.p, arm.rotor, arm.momentum, geometry, s.rate, s.gain, s.work, s.second, tau
    )


@helper
def _gap(arm, s):  # type: ignore[no-untyped-def]
    """Return the least gap between bodies that are not neighbours, at the scratch's state."""
    d, radii = s.work[0], arm.radii
    write_chain(arm.p, s.state, d, s.work[1])
    least, a = _NO_GAP, d[0]
    for i in range(2, d.size):
        a += d[i - 1]  # start of link i
        least = min(least, point_distance(a, d[i], 0j) - radii[0] - radii[1])
        b = d[0]
        for j in range(1, i - 1):
            least = min(least, segment_distance(a, d[i], b, d[j]) - 2.0 * radii[1])
            b += d[j]
    return least


@kernel("(p),(n),(u)->()")
def _gaps(p, q_m, radii, out):  # type: ignore[no-untyped-def]
    scratch, none = make_scratch(q_m.size), np.zeros((1, 1))
    scratch.state[:3] = 0.0
    scratch.state[3:] = q_m
    out[0] = _gap(Limited(p.copy(), none[0], 0.0, none, none, radii.copy()), scratch)


def gaps(p: npt.ArrayLike, q_m: npt.ArrayLike, radii: npt.ArrayLike) -> Floats:
    """Return the least gap between bodies that are not neighbours, (...) [m]; collision below 0.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q_m: (..., n) joint readings [rad].
        radii: (2,) of the base and of links [m].
    """
    return np.asarray(_gaps(p, q_m, radii))


@helper
def _at(point, h, q, qd, s):  # type: ignore[no-untyped-def]
    """Set the scratch's state, rate and gain to a point of a segment with knots (2, n)."""
    b = _BASIS[point]
    for i in range(q.shape[1]):
        q0, q1, v0, v1 = q[0, i], q[1, i], h * qd[0, i], h * qd[1, i]
        s.state[3 + i] = b[0, 0] * q0 + b[0, 1] * v0 + b[0, 2] * q1 + b[0, 3] * v1
        s.rate[3 + i] = (b[1, 0] * q0 + b[1, 1] * v0 + b[1, 2] * q1 + b[1, 3] * v1) / h
        s.gain[3 + i] = (b[2, 0] * q0 + b[2, 1] * v0 + b[2, 2] * q1 + b[2, 3] * v1) / (h * h)


@helper
def is_constrained(r, n, k, point, segments):  # type: ignore[no-untyped-def]
    """Return True if quantity r is limited at a point.

    Accelerations are largest at a segment's ends; the first and last posture are given.
    """
    if r > 3 * n:
        return point == 0 or point == POINTS - 1
    if r == n or r > 2 * n:
        return not ((k == 0 and point == 0) or (k == segments - 1 and point == POINTS - 1))
    return True


@helper
def _margin(room, value, low, high):  # type: ignore[no-untyped-def]
    room[0], room[1] = value - low, high - value


@helper
def write_distances(arm, s, h, q, qd, room, omegas):  # type: ignore[no-untyped-def]
    """Write the distances (K, 5, 4 n + 1, 2) to both limits, and the base's rates (K, 5).

    Returns the least distance.
    """
    n, least, limits = q.shape[1], math.inf, arm.limits
    for k in range(h.size):
        for j in range(POINTS):
            _at(j, h[k], q[k : k + 2], qd[k : k + 2], s)
            geometry = write_geometry(arm.p, s.state, s.work, s.second)
            omegas[k, j] = _torques(arm, s, geometry, s.tau)
            own = room[k, j]
            _margin(own[n], _gap(arm, s), arm.radii[2], 2.0 * _NO_GAP)
            for i in range(n):
                load = s.tau[3 + i] + limits[i, 3] * s.rate[3 + i]
                _margin(own[i], load, -limits[i, 2], limits[i, 2])
                _margin(own[n + 1 + i], s.rate[3 + i], -limits[i, 0], limits[i, 0])
                _margin(own[2 * n + 1 + i], s.state[3 + i], arm.bounds[i, 0], arm.bounds[i, 1])
                _margin(own[3 * n + 1 + i], s.gain[3 + i], -limits[i, 1], limits[i, 1])
            for r in range(4 * n + 1):
                if is_constrained(r, n, k, j, h.size):
                    least = min(least, own[r, 0], own[r, 1])
    return least


@helper
def _by_variables(point, order, h, q, qd, i, out):  # type: ignore[no-untyped-def]
    """Write the derivatives of joint i's q, q' or q'' by q_0, q'_0, h, q_1, q'_1: out (5,)."""
    b, scale = _BASIS[point, order], h ** (-order)
    out[0], out[1], out[3], out[4] = b[0] * scale, b[1] * scale * h, b[2] * scale, b[3] * scale * h
    angles, rates = b[0] * q[0, i] + b[2] * q[1, i], b[1] * qd[0, i] + b[3] * qd[1, i]
    out[2] = -order * angles * scale / h + (1 - order) * rates * scale


@helper
def write_derivatives(arm, s, point, h, q, qd, timed, rows):  # type: ignore[no-untyped-def]
    """Write the derivatives (4 n + 2, 4 n + 1) of limited quantities and of the base's rate.

    The derivatives are by a segment's variables, including h if times are free.
    """
    n, part = q.shape[1], s.part
    _at(point, h, q, qd, s)
    geometry = write_geometry(arm.p, s.state, s.work, s.second)
    omega, gap = _torques(arm, s, geometry, s.tau), _gap(arm, s)
    rows[:] = 0.0
    for order in (1, 2, 0):  # orders that do not change the geometry come first
        moved = s.state if order == 0 else (s.rate if order == 1 else s.gain)
        own = (2 * n + 1) if order == 0 else ((n + 1) if order == 1 else (3 * n + 1))
        size = 1.0 if order == 2 else _DIFFERENCE  # linear in accelerations
        for i in range(n):
            moved[3 + i] += size
            if order == 0:
                geometry = write_geometry(arm.p, s.state, s.work, s.second)
            ahead = _torques(arm, s, geometry, s.other)
            nearer = _gap(arm, s) - gap if order == 0 else 0.0
            moved[3 + i] -= size
            _by_variables(point, order, h, q, qd, i, part)
            if not timed:
                part[2] = 0.0
            for r in range(n + 3):
                if r < n:
                    row, slope = r, (s.other[3 + r] - s.tau[3 + r]) / size
                    slope += arm.limits[i, 3] if order == 1 and r == i else 0.0
                elif r == n:
                    row, slope = n, nearer / size
                elif r == n + 1:
                    row, slope = 4 * n + 1, (ahead - omega) / size
                else:
                    row, slope = own + i, 1.0
                rows[row, i] += slope * part[0]
                rows[row, n + i] += slope * part[1]
                rows[row, 2 * n] += slope * part[2]
                rows[row, 2 * n + 1 + i] += slope * part[3]
                rows[row, 3 * n + 1 + i] += slope * part[4]


@helper
def total_turn(h, omegas):  # type: ignore[no-untyped-def]
    """Return the integral of the base's rate."""
    total = 0.0
    for k in range(h.size):
        for j in range(POINTS):
            total += h[k] * WEIGHTS[j] * omegas[k, j]
    return total
