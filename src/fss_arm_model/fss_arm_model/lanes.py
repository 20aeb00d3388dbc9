"""Parallel rollouts: the dynamics of centroidal.py with one lane for each rollout.

Each number there is a row of numbers here, one for each lane. The innermost loop runs over the
lanes, so that the processor's vector instructions compute several at once. The numbers of one body
are neighbours in memory, (bodies, rows, lanes), so that their distances are constants for the
compiler, which then knows that they do not overlap. Vectors are stored as x and y because complex
numbers do not vectorize.

All functions are inlined into kernels that give the number of lanes, so this is a constant, too. No
lane's arithmetic depends on other lanes, except in `_advance_rotation`: if one lane turns far, it
uses the slower method for all. Both methods agree to the last digit or two.
"""

import math

import numpy as np

from .centroidal import scaled
from .kernels import helper, inlined
from .kinematics import body_com, body_inertia, body_mass, body_reach, dot
from .layout import LINK_SIZE, MOUNT_ANGLE, OFFSET

# Rows of a body's constants: D - b, M b, diagonal of the inertia, and the joints' terms beside it.
SX, SY, TX, TY, DIAGONAL, OFF_DIAGONAL = range(6)
CONSTANTS = 6
# Rows of a body's scratch: S, T, the square of its rate; then of L, and the joint's term.
SPIN, LX, LY, JOINT = 4, 5, 6, 7
SCRATCH = 8
# Rows of sums along the chain.
OUTER, INNER, G, PREVIOUS, XX, XY, YY, FORWARD, INVERSE, TWIST = 0, 2, 4, 6, 8, 9, 10, 11, 12, 13
SUMS = 14

# Largest angle of the series below [rad]. Their truncation error is less than x^13 / 13!, 2e-18.
MAX_SERIES_ANGLE = 0.25


@helper
def _constants(p, rotor, bodies, mass):  # type: ignore[no-untyped-def]
    """Write the constants of p (lanes, 8 + 6 n) and the total masses (lanes,); see _bodies."""
    for j in range(mass.size):
        M = 0.0
        for k in range(bodies.shape[0]):
            M += body_mass(p[j], k)
        mass[j] = beyond = M
        for k in range(bodies.shape[0]):
            m = body_mass(p[j], k)
            beyond -= m
            D, E = body_reach(p[j], k), body_com(p[j], k)
            T = scaled(m, E) + scaled(beyond, D)
            S = D - scaled(1.0 / M, T)
            bodies[k, SX, j], bodies[k, SY, j] = S.real, S.imag
            bodies[k, TX, j], bodies[k, TY, j] = T.real, T.imag
            about_pivot = body_inertia(p[j], k) + m * dot(E, E) + beyond * dot(D, D)
            bodies[k, DIAGONAL, j] = about_pivot - dot(T, T) / M
            bodies[k, OFF_DIAGONAL, j] = 0.0
        for k in range(1, bodies.shape[0]):
            bodies[k - 1, DIAGONAL, j] += rotor[0] - 2.0 * rotor[1]
            bodies[k, DIAGONAL, j] += rotor[0]
            bodies[k, OFF_DIAGONAL, j] = rotor[1] - rotor[0]


@inlined
def _advance_rotation(lanes, start, y0, y, u):  # type: ignore[no-untyped-def]
    """Write u at the angles of y, from `start`, the u of y0."""
    for k in range(u.shape[0]):
        largest = 0.0
        for j in range(lanes):
            largest = max(largest, abs(y[2 + k, j] - y0[2 + k, j]))
        if largest > MAX_SERIES_ANGLE:
            for j in range(lanes):
                u[k, 0, j], u[k, 1, j] = math.cos(y[2 + k, j]), math.sin(y[2 + k, j])
        else:
            for j in range(lanes):
                t = y[2 + k, j] - y0[2 + k, j]
                x = t * t
                c = -1 / 720 + x * (1 / 40320 + x * (-1 / 3628800 + x * (1 / 479001600)))
                c = 1.0 + x * (-1 / 2 + x * (1 / 24 + x * c))
                s = -1 / 5040 + x * (1 / 362880 + x * (-1 / 39916800))
                s = t * (1.0 + x * (-1 / 6 + x * (1 / 120 + x * s)))
                a, b = start[k, 0, j], start[k, 1, j]
                u[k, 0, j], u[k, 1, j] = a * c - b * s, a * s + b * c


@inlined
def _origin(lanes, bodies, mass, u, y, v, r):  # type: ignore[no-untyped-def]
    """Write position and velocity of the base's origin to the rows of r (4, lanes)."""
    for j in range(lanes):
        r[0, j], r[1, j], r[2, j], r[3, j] = y[0, j], y[1, j], v[0, j], v[1, j]
    for k in range(u.shape[0]):
        for j in range(lanes):
            a, b, scale = bodies[k, TX, j], bodies[k, TY, j], 1.0 / mass[j]
            x = scale * (a * u[k, 0, j] - b * u[k, 1, j])
            z = scale * (a * u[k, 1, j] + b * u[k, 0, j])
            r[0, j] -= x
            r[1, j] -= z
            r[2, j] += v[2 + k, j] * z
            r[3, j] -= v[2 + k, j] * x


@inlined
def _rate(lanes, bodies, mass, around, u, v, tau, work, sums, a):  # type: ignore[no-untyped-def]
    """Write a (2 + m, lanes), as centroidal.write_rate does.

    tau (2 + m, lanes) is the force on the base's origin and the torques on the bodies; around (5,)
    has the external effects that `rollout` describes.
    """
    m, film, drag = u.shape[0], around[2], around[3]
    for j in range(lanes):
        for i in range(SUMS):
            sums[i, j] = 0.0
        sums[INVERSE, j] = 1.0
        sums[TWIST, j] = -around[4] * v[2, j]
        sums[INNER, j], sums[INNER + 1, j] = 0.0, 0.0  # first the origin's velocity
    for k in range(m):
        for j in range(lanes):
            c, s, omega = u[k, 0, j], u[k, 1, j], v[2 + k, j]
            work[k, SX, j] = bodies[k, SX, j] * c - bodies[k, SY, j] * s
            work[k, SY, j] = bodies[k, SX, j] * s + bodies[k, SY, j] * c
            tx = bodies[k, TX, j] * c - bodies[k, TY, j] * s
            ty = bodies[k, TX, j] * s + bodies[k, TY, j] * c
            spin = omega * omega
            work[k, TX, j], work[k, TY, j], work[k, SPIN, j] = tx, ty, spin
            sums[OUTER, j] += spin * tx
            sums[OUTER + 1, j] += spin * ty
            sums[INNER, j] += omega * ty
            sums[INNER + 1, j] -= omega * tx
    for j in range(lanes):
        light = 1.0 / mass[j]
        x = light * (tau[0, j] - drag * (v[0, j] + light * sums[INNER, j]))
        y = light * (tau[1, j] - drag * (v[1, j] + light * sums[INNER + 1, j]))
        sums[INNER, j], sums[INNER + 1, j] = -x, -y
        a[0, j] = x + around[0] - film * v[0, j]
        a[1, j] = y + around[1] - film * v[1, j]
    for k in range(m):
        for j in range(lanes):
            sx, sy, tx, ty = work[k, SX, j], work[k, SY, j], work[k, TX, j], work[k, TY, j]
            spin, r, inverse = work[k, SPIN, j], bodies[k, OFF_DIAGONAL, j], sums[INVERSE, j]
            beside = r * inverse
            bx, by = sums[OUTER, j] - spin * tx, sums[OUTER + 1, j] - spin * ty
            ex, ey = sums[INNER, j], sums[INNER + 1, j]
            Q = tau[2 + k, j] + sums[TWIST, j] + (sx * by - sy * bx) - (ex * ty - ey * tx)
            sums[TWIST, j] = 0.0
            sums[OUTER, j], sums[OUTER + 1, j] = bx, by
            sums[INNER, j], sums[INNER + 1, j] = ex + spin * sx, ey + spin * sy
            xx, xy, yy = sums[XX, j], sums[XY, j], sums[YY, j]
            lx, ly = sums[PREVIOUS, j], sums[PREVIOUS + 1, j]
            px, py = xx * tx + xy * ty + r * lx, xy * tx + yy * ty + r * ly
            d = bodies[k, DIAGONAL, j] - r * (tx * lx + ty * ly + beside) - (tx * px + ty * py)
            inverse = 1.0 / d
            gx, gy = sums[G, j], sums[G + 1, j]
            forward = Q - (tx * gx + ty * gy) - beside * sums[FORWARD, j]
            sx -= px
            sy -= py
            lx, ly = inverse * sx, inverse * sy
            sums[XX, j], sums[XY, j], sums[YY, j] = xx + sx * lx, xy + sx * ly, yy + sy * ly
            sums[G, j], sums[G + 1, j] = gx + forward * lx, gy + forward * ly
            sums[PREVIOUS, j], sums[PREVIOUS + 1, j] = lx, ly
            sums[FORWARD, j], sums[INVERSE, j] = forward, inverse
            work[k, LX, j], work[k, LY, j], work[k, JOINT, j] = lx, ly, beside
            a[2 + k, j] = forward * inverse
    for j in range(lanes):  # backward pass: back, joint's term, next body's solution
        sums[0, j], sums[1, j], sums[2, j], sums[3, j] = 0.0, 0.0, 0.0, 0.0
    for k in range(m - 1, -1, -1):
        for j in range(lanes):
            back = work[k, LX, j] * sums[0, j] + work[k, LY, j] * sums[1, j]
            solved = a[2 + k, j] - back - sums[2, j] * sums[3, j]
            sums[2, j], sums[3, j] = work[k, JOINT, j], solved
            sums[0, j] += solved * work[k, TX, j]
            sums[1, j] += solved * work[k, TY, j]
            a[2 + k, j] = solved - film * v[2 + k, j]


@inlined
def roll_lanes(lanes, p, q0, qd0, tau, rotor, around, step, q, qd):  # type: ignore[no-untyped-def]
    """Write the states q, qd (lanes, steps, 3 + n) after each step, by the classical method."""
    m, N = q0.shape[1] - 2, q0.shape[1]
    bodies, mass = np.empty((m, CONSTANTS, lanes)), np.empty(lanes)
    _constants(p, rotor, bodies, mass)
    start, u = np.empty((m, 2, lanes)), np.empty((m, 2, lanes))
    y0, v0, y, v = (
        np.empty((N, lanes)),
        np.empty((N, lanes)),
        np.empty((N, lanes)),
        np.empty((N, lanes)),
    )
    a, y_sum, v_sum = np.empty((N, lanes)), np.empty((N, lanes)), np.empty((N, lanes))
    given = np.empty((N, lanes))
    work, sums, origin = (
        np.empty((m, SCRATCH, lanes)),
        np.empty((SUMS, lanes)),
        np.empty((4, lanes)),
    )
    h, offset = step[0], np.zeros((m, lanes))
    for j in range(lanes):
        y0[2, j], v0[2, j] = q0[j, 2], qd0[j, 2]
        for k in range(1, m):
            mount = p[j, MOUNT_ANGLE] if k == 1 else 0.0
            offset[k, j] = p[j, LINK_SIZE * k + OFFSET] + mount
            y0[2 + k, j] = y0[1 + k, j] + offset[k, j] + q0[j, 2 + k]
            v0[2 + k, j] = v0[1 + k, j] + qd0[j, 2 + k]
        for k in range(m):
            start[k, 0, j], start[k, 1, j] = math.cos(y0[2 + k, j]), math.sin(y0[2 + k, j])
        y0[0, j], y0[1, j], v0[0, j], v0[1, j] = 0.0, 0.0, 0.0, 0.0
    _origin(lanes, bodies, mass, start, y0, v0, origin)  # relative to the centre of mass
    for j in range(lanes):
        y0[0, j], y0[1, j] = q0[j, 0] - origin[0, j], q0[j, 1] - origin[1, j]
        v0[0, j], v0[1, j] = qd0[j, 0] - origin[2, j], qd0[j, 1] - origin[3, j]
    for t in range(tau.shape[1]):
        for j in range(lanes):
            given[0, j], given[1, j] = tau[j, t, 0], tau[j, t, 1]
            for i in range(2, N - 1):
                given[i, j] = tau[j, t, i] - tau[j, t, i + 1]
            given[N - 1, j] = tau[j, t, N - 1]
        for i in range(N):
            for j in range(lanes):
                y[i, j], v[i, j], y_sum[i, j], v_sum[i, j] = y0[i, j], v0[i, j], 0.0, 0.0
        for stage in range(4):
            if stage == 0:
                for k in range(m):
                    for j in range(lanes):
                        u[k, 0, j], u[k, 1, j] = start[k, 0, j], start[k, 1, j]
            else:
                _advance_rotation(lanes, start, y0, y, u)
            _rate(lanes, bodies, mass, around, u, v, given, work, sums, a)
            weight = h / 6 if stage == 0 or stage == 3 else h / 3
            reach = h if stage == 2 else h / 2
            for i in range(N):
                for j in range(lanes):
                    y_sum[i, j] += weight * v[i, j]
                    v_sum[i, j] += weight * a[i, j]
                    y[i, j] = y0[i, j] + reach * v[i, j]
                    v[i, j] = v0[i, j] + reach * a[i, j]
        for i in range(N):
            for j in range(lanes):
                y[i, j] = y0[i, j] + y_sum[i, j]
                v0[i, j] += v_sum[i, j]
        _advance_rotation(lanes, start, y0, y, u)
        for k in range(m):
            for j in range(lanes):
                start[k, 0, j], start[k, 1, j] = u[k, 0, j], u[k, 1, j]
        for i in range(N):
            for j in range(lanes):
                y0[i, j] = y[i, j]
        _origin(lanes, bodies, mass, u, y0, v0, origin)
        for j in range(lanes):
            q[j, t, 0], q[j, t, 1], q[j, t, 2] = origin[0, j], origin[1, j], y0[2, j]
            qd[j, t, 0], qd[j, t, 1], qd[j, t, 2] = origin[2, j], origin[3, j], v0[2, j]
            for k in range(1, m):
                q[j, t, 2 + k] = y0[2 + k, j] - y0[1 + k, j] - offset[k, j]
                qd[j, t, 2 + k] = v0[2 + k, j] - v0[1 + k, j]
