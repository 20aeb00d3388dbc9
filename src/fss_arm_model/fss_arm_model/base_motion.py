"""Predict the base's motion from the arm's: d(b, m, I, theta(t)) of Eq. 6, without an ODE.

No torque acts about the system's centre of mass. A uniform force, the weight on a tilted table,
acts at it. So the angular momentum L about it is constant, and the centre follows a parabola. With
K_k, s_k of _inertias below, Q_k = q_1 + .. + q_k, M the total mass and g the acceleration down the
table,

    L = sum_k N_k (theta' + Q'_k)
    N_k = K_k - |s_k|^2 / M + s_k . sum_{j<k} p_j + p_k . sum_{j>k} s_j,   p_k = d_k - s_k / M
    theta(t) = theta(0) + int (L dt - sum_k N_k dQ_k) / sum_k N_k
    r(t) = c(0) + P t / M + g t^2 / 2 - exp(i theta(t)) s(t) / M,   s = sum_k s_k

with all vectors in the base's frame. The contribution of the path in joint space is computed once,
as nodes of a quadrature (joint_path); then a prediction is a sum over the nodes, and so are its
derivatives. Planar vectors are complex numbers and the bodies are numbered as in kinematics.py.
"""

import math

import numpy as np
import numpy.typing as npt

from . import layout
from .arrays import Floats
from .centroidal import scaled
from .joint_path import Path
from .kernels import helper, inlined, kernel
from .kinematics import SIZE_THREE, body_com, body_inertia, body_mass, body_reach, dot

#: Columns of base_pose_sensitivities that follow those of Arm.vector().
STATE_NAMES = ("x", "y", "theta", "p_x", "p_y", "L", "g_x", "g_y")

LANES = 16  # nodes that are computed side by side
# Starts of rows of lanes. For a body: the path's three rows, then results of _headings, from which
# _gradients computes a node's contribution to the derivatives by s_k, d_k and K_k.
COS, SIN, RATE, SX, SY, PX, PY, OMEGA, BODY = range(0, 9 * LANES, LANES)
# For sums: all s; p before and s after a body, and both with rates; N, dt, and a node's results.
TX, TY, BX, BY, AX, AY, OX, OY, MX, MY, TOTAL, DT, TURN, BY_M, BY_L, SUMS = range(
    0, 16 * LANES, LANES
)


@helper
def _inertias(p, delta, sigma, K):  # type: ignore[no-untyped-def]
    """Write the bodies' constants, in each body's frame with the joint before it at reading 0.

    d_k is the vector from its pivot to the next, s_k = m_k e_k + d_k sum_{j>k} m_j its first moment
    and K_k = I_k + m_k |e_k|^2 + |d_k|^2 sum_{j>k} m_j its second, with the mass of all further
    bodies at the next pivot. The motion depends on masses, inertias and centres of mass only
    through these combinations.

    Returns:
        The total mass.
    """
    M = 0.0
    for k in range(K.size - 1, -1, -1):
        d, e = body_reach(p, k), body_com(p, k)
        m = body_mass(p, k)
        delta[k], sigma[k] = d, M * d + m * e
        K[k] = body_inertia(p, k) + m * dot(e, e) + M * dot(d, d)
        M += m
    angle = p[layout.MOUNT_ANGLE]
    for k in range(1, K.size):
        angle += p[layout.LINK_SIZE * k + layout.OFFSET]
        turn = complex(math.cos(angle), math.sin(angle))
        delta[k] *= turn
        sigma[k] *= turn
    return M


@helper
def _turn_bodies(delta, sigma, row, d, s):  # type: ignore[no-untyped-def]
    """Turn the bodies to a row of a path: write d_k and s_k; return their sum s."""
    d[0], s[0] = delta[0], sigma[0]
    total = s[0]
    for k in range(1, d.size):
        turn = complex(row[2 * k - 2], row[2 * k - 1])
        d[k], s[k] = delta[k] * turn, sigma[k] * turn
        total += s[k]
    return total


@inlined
def _headings(nodes, first, delta, sigma, K, per_mass, L, work, sums):  # type: ignore[no-untyped-def]
    """Write the base's rotation at the nodes from `first` on, one lane for each node.

    Intermediate results stay in work and sums for _gradients. Lanes beyond the last node keep their
    old values.
    """
    m, rows = delta.size, nodes[first : first + LANES]
    n = m - 1
    for j in range(rows.shape[0]):
        sums[DT + j] = rows[j, 3 * n]
    for k in range(1, m):
        body = work[BODY * k : BODY * (k + 1)]
        for j in range(rows.shape[0]):
            body[COS + j], body[SIN + j] = rows[j, 2 * k - 2], rows[j, 2 * k - 1]
            body[RATE + j] = rows[j, 2 * n + k - 1]
    for j in range(LANES):
        sums[TX + j], sums[TY + j] = 0.0, 0.0
    for k in range(m):
        body = work[BODY * k : BODY * (k + 1)]
        dx, dy, sx, sy = delta[k].real, delta[k].imag, sigma[k].real, sigma[k].imag
        for j in range(LANES):
            c, s = body[COS + j], body[SIN + j]
            body[PX + j], body[PY + j] = dx * c - dy * s, dx * s + dy * c
            x, y = sx * c - sy * s, sx * s + sy * c
            body[SX + j], body[SY + j] = x, y
            sums[TX + j] += x
            sums[TY + j] += y
    for j in range(LANES):
        sums[BX + j], sums[BY + j] = 0.0, 0.0
        sums[AX + j], sums[AY + j] = sums[TX + j], sums[TY + j]
        sums[TOTAL + j], sums[TURN + j] = 0.0, L * sums[DT + j]
    for k in range(m):
        body = work[BODY * k : BODY * (k + 1)]
        own = K[k]
        for j in range(LANES):
            sx, sy = body[SX + j], body[SY + j]
            ax, ay = sums[AX + j] - sx, sums[AY + j] - sy
            px, py = body[PX + j] - per_mass * sx, body[PY + j] - per_mass * sy
            bx, by = sums[BX + j], sums[BY + j]
            N = own - per_mass * (sx * sx + sy * sy) + (sx * bx + sy * by) + (px * ax + py * ay)
            body[PX + j], body[PY + j], body[OMEGA + j] = px, py, N
            sums[AX + j], sums[AY + j], sums[BX + j], sums[BY + j] = ax, ay, bx + px, by + py
            sums[TOTAL + j] += N
            sums[TURN + j] -= N * body[RATE + j]
    for j in range(LANES):
        sums[TURN + j] = sums[TURN + j] / sums[TOTAL + j]


@inlined
def _gradients(per_mass, work, sums):  # type: ignore[no-untyped-def]
    """Write each node's contribution to the derivatives of the heading, after _headings.

    The derivatives by s_k and d_k (in the frame of body k) and K_k go to work, those by M and the
    added L to sums. With constant L, the derivative by any parameter is
    -(1 / N) sum_k omega_k dN_k with N = sum_k N_k. As N_k is the sum over j of the symmetric
    M_jk = p_j . s_k (j < k), terms of bodies j and k contain omega_j + omega_k.
    """
    m = work.shape[0] // BODY
    for j in range(LANES):
        sums[TOTAL + j] = 1.0 / sums[TOTAL + j]
        sums[MX + j], sums[MY + j] = 0.0, 0.0  # sum of omega_k s_k
    for k in range(m):
        body = work[BODY * k : BODY * (k + 1)]
        # omega has a weight: the node's angle of each body, over N.
        for j in range(LANES):
            omega = sums[TOTAL + j] * (sums[TURN + j] + body[RATE + j])
            body[OMEGA + j] = omega
            sums[MX + j] += omega * body[SX + j]
            sums[MY + j] += omega * body[SY + j]
    for j in range(LANES):
        about = sums[TX + j] * sums[MX + j] + sums[TY + j] * sums[MY + j]
        sums[BY_M + j] = per_mass * per_mass * about
        sums[BY_L + j] = sums[TOTAL + j] * sums[DT + j]
        sums[AX + j], sums[AY + j] = sums[TX + j], sums[TY + j]
        sums[BX + j], sums[BY + j] = 0.0, 0.0
        sums[OX + j], sums[OY + j] = 0.0, 0.0  # sum of omega_j p_j
    for k in range(m):
        body = work[BODY * k : BODY * (k + 1)]
        for j in range(LANES):
            omega, sx, sy = body[OMEGA + j], body[SX + j], body[SY + j]
            c, s, px, py = body[COS + j], body[SIN + j], body[PX + j], body[PY + j]
            ax, ay = sums[AX + j] - sx, sums[AY + j] - sy
            mx, my = sums[MX + j] - omega * sx, sums[MY + j] - omega * sy
            bx, by, ox, oy = sums[BX + j], sums[BY + j], sums[OX + j], sums[OY + j]
            dx, dy = omega * ax + mx, omega * ay + my
            twice = 2.0 * omega
            x = omega * bx + ox - per_mass * (dx + twice * sx)
            y = omega * by + oy - per_mass * (dy + twice * sy)
            body[SX + j], body[SY + j] = x * c + y * s, y * c - x * s
            body[PX + j], body[PY + j] = dx * c + dy * s, dy * c - dx * s
            sums[AX + j], sums[AY + j], sums[MX + j], sums[MY + j] = ax, ay, mx, my
            sums[BX + j], sums[BY + j] = bx + px, by + py
            sums[OX + j], sums[OY + j] = ox + omega * px, oy + omega * py


@helper
def _rotation(angle):  # type: ignore[no-untyped-def]
    return complex(math.cos(angle), math.sin(angle))


@helper
def _course(state, M, t):  # type: ignore[no-untyped-def]
    """Return the displacement of the centre of mass at time t."""
    u, v = t / M, 0.5 * t * t
    return complex(state[3] * u + state[6] * v, state[4] * u + state[7] * v)


@kernel("(p),(b),(c,j),(m,l),(t)->(m,t)")
def _base_poses(p, state, nodes, marks, _t, poses):  # type: ignore[no-untyped-def]
    size = (nodes.shape[1] - 1) // 3 + 1
    delta, sigma, d, s = np.empty((4, size), np.complex128)
    K, work, sums = np.empty(size), np.empty(size * BODY), np.empty(SUMS)
    work[:], sums[:], work[COS : COS + LANES] = 0.0, 0.0, 1.0
    M = _inertias(p, delta, sigma, K)
    per_mass, heading, done = 1.0 / M, state[2], 0
    begin = 0j
    for i in range(marks.shape[0]):
        until, t = int(marks[i, 2 * size - 2]), marks[i, 2 * size - 1]
        while done < until:
            lane = done % LANES
            if lane == 0:
                _headings(nodes, done, delta, sigma, K, per_mass, state[5], work, sums)
            beyond = min(lane + until - done, LANES)
            for j in range(lane, beyond):
                heading += sums[TURN + j]
            done += beyond - lane
        z = _rotation(heading) * _turn_bodies(delta, sigma, marks[i], d, s)
        if i == 0:
            begin = z
        away = _course(state, M, t) + (begin - z) / M
        poses[i, 0], poses[i, 1] = state[0] + away.real, state[1] + away.imag
        poses[i, 2] = heading


@helper
def _chain_rule(p, delta, M, gM, Gs, Gd, gK, sigma, out):  # type: ignore[no-untyped-def]
    """Write the derivatives by Arm.vector(), from those by M, s_k, d_k and K_k."""
    spin, behind, beyond = 0.0, 0.0, M
    for k in range(1, gK.size):
        spin += _cross_dot(Gs[k], sigma[k]) + _cross_dot(Gd[k], delta[k])
    out[layout.MOUNT_ANGLE], out[layout.TIP_ANGLE] = spin, 0.0
    for k in range(gK.size):
        m = body_mass(p, k)
        beyond -= m
        d, e = body_reach(p, k), body_com(p, k)
        by_s, by_d = Gs[k], Gd[k]
        if k > 0:  # from the frame at reading 0 to the link's own frame
            a = p[layout.LINK_SIZE * k + layout.LENGTH]
            back = complex(delta[k].real / a, -delta[k].imag / a)
            by_s, by_d = by_s * back, by_d * back
        by_mass = gM + behind + dot(by_s, e) + gK[k] * dot(e, e)
        by_e = scaled(m, by_s) + scaled(2.0 * m * gK[k], e)
        behind += dot(by_s, d) + gK[k] * dot(d, d)
        by_d += scaled(beyond, by_s) + scaled(2.0 * beyond * gK[k], d)
        if k == 0:
            out[layout.MASS], out[layout.INERTIA] = by_mass, gK[0]
            out[layout.COM_X], out[layout.COM_Y] = by_e.real, by_e.imag
            out[layout.MOUNT_X], out[layout.MOUNT_Y] = by_d.real, by_d.imag
        else:
            link = out[layout.LINK_SIZE * k :]
            link[layout.LENGTH], link[layout.OFFSET] = by_d.real, spin
            link[layout.LINK_MASS], link[layout.LINK_INERTIA] = by_mass, gK[k]
            link[layout.G], link[layout.LATERAL] = by_e.real, by_e.imag
            spin -= _cross_dot(Gs[k], sigma[k]) + _cross_dot(Gd[k], delta[k])


@helper
def _cross_dot(gradient, r):  # type: ignore[no-untyped-def]
    """Return the derivative by a rotation of r."""
    return gradient.imag * r.real - gradient.real * r.imag


@kernel("(p),(b),(c,j),(m,l),(t),(x)->(m,t),(m,t,x)")
def _base_pose_sensitivities(p, state, nodes, marks, _t, _x, poses, J):  # type: ignore[no-untyped-def]
    size = (nodes.shape[1] - 1) // 3 + 1
    delta, sigma, d, s, Gs, Gd, by_s, by_d = np.zeros((8, size), np.complex128)
    K, gK, by_K = np.zeros((3, size))
    g = np.zeros(2)
    work, sums = np.empty(size * BODY), np.empty(SUMS)
    work[:], sums[:], work[COS : COS + LANES] = 0.0, 0.0, 1.0
    M = _inertias(p, delta, sigma, K)
    per_mass, heading, done = 1.0 / M, state[2], 0
    begin, start, columns = 0j, _rotation(state[2]), p.size
    J[:] = 0.0
    for i in range(marks.shape[0]):
        until, t = int(marks[i, 2 * size - 2]), marks[i, 2 * size - 1]
        while done < until:
            lane = done % LANES
            if lane == 0:
                _headings(nodes, done, delta, sigma, K, per_mass, state[5], work, sums)
                _gradients(per_mass, work, sums)
            beyond = min(lane + until - done, LANES)
            for j in range(lane, beyond):
                heading += sums[TURN + j]
                g[0] -= sums[BY_M + j]
                g[1] += sums[BY_L + j]
            for k in range(size):
                body = work[BODY * k + lane : BODY * (k + 1)]
                sx, sy, dx, dy, total = Gs[k].real, Gs[k].imag, Gd[k].real, Gd[k].imag, gK[k]
                for j in range(beyond - lane):
                    sx, sy = sx - body[SX + j], sy - body[SY + j]
                    dx, dy = dx - body[PX + j], dy - body[PY + j]
                    total -= body[OMEGA + j]
                Gs[k], Gd[k], gK[k] = complex(sx, sy), complex(dx, dy), total
            done += beyond - lane
        turn = _rotation(heading)
        z = turn * _turn_bodies(delta, sigma, marks[i], d, s) * per_mass
        if i == 0:
            begin = z
        away = _course(state, M, t) + begin - z
        poses[i, 0], poses[i, 1] = state[0] + away.real, state[1] + away.imag
        poses[i, 2] = heading
        _chain_rule(p, delta, M, g[0], Gs, Gd, gK, sigma, J[i, 2])
        J[i, 2, columns + 2], J[i, 2, columns + 5] = 1.0, g[1]
        drift = complex(state[3], state[4]) * (t * per_mass)
        by_M = (z - begin - drift) * per_mass
        for axis in range(2):
            # d(x + i y) = .. - i z d theta; its real and imaginary part
            by_heading = z.imag if axis == 0 else -z.real
            for k in range(size):
                first = complex(1.0, 0.0)
                now = first
                if k > 0:
                    first = complex(marks[0, 2 * k - 2], marks[0, 2 * k - 1])
                    now = complex(marks[i, 2 * k - 2], marks[i, 2 * k - 1])
                c = scaled(per_mass, start * first - turn * now)
                own = complex(c.real, -c.imag) if axis == 0 else complex(c.imag, c.real)
                by_s[k] = own + scaled(by_heading, Gs[k])
                by_d[k] = scaled(by_heading, Gd[k])
                by_K[k] = by_heading * gK[k]
            gM = (by_M.real if axis == 0 else by_M.imag) + by_heading * g[0]
            _chain_rule(p, delta, M, gM, by_s, by_d, by_K, sigma, J[i, axis])
            J[i, axis, columns + axis] = 1.0
            J[i, axis, columns + 2] = by_heading + (-begin.imag if axis == 0 else begin.real)
            J[i, axis, columns + 3 + axis] = t * per_mass
            J[i, axis, columns + 5] = by_heading * g[1]
            J[i, axis, columns + 6 + axis] = 0.5 * t * t


def _checked(p: npt.ArrayLike, path: Path, state: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return the arrays p and state.

    Raises:
        ValueError: a last dimension is wrong.
    """
    p, state = np.asarray(p, dtype=float), np.asarray(state, dtype=float)
    n = (path.nodes.shape[-1] - 1) // 3
    if p.shape[-1] != layout.size(n) or state.shape[-1] != len(STATE_NAMES):
        raise ValueError(
            f"p and state have the shapes {p.shape} and {state.shape}, "
            f"expected (..., {layout.size(n)}) and (..., {len(STATE_NAMES)})"
        )
    return p, state


def base_poses(p: npt.ArrayLike, path: Path, state: npt.ArrayLike) -> Floats:
    """Predict the base's poses at a path's marks (Eq. 6), (..., m, 3): x, y [m], heading [rad].

    The heading is continuous (not wrapped), starting from the heading in `state`.

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        path: the path of the joints.
        state: (..., 8) as STATE_NAMES: the base's pose at the first mark [m, m, rad]; the momentum
            there [N s, N s, N m s], that about the system's centre of mass; the acceleration of
            free bodies down a tilted table [m/s^2].

    Raises:
        ValueError: shapes do not fit.
    """
    p, state = _checked(p, path, state)
    return _base_poses(p, state, *path, SIZE_THREE)


def base_pose_sensitivities(
    p: npt.ArrayLike, path: Path, state: npt.ArrayLike
) -> tuple[Floats, Floats]:
    """Return base_poses and its derivatives (Phi_d of Eq. 10, by all parameters).

    Returns:
        (..., m, 3) poses and (..., m, 3, 8 + 6 n + 8) their derivatives by p and then state, each
            in its unit. Those by g (centres of mass) are at constant lengths: a derivative by b is
            minus that by g.

    Raises:
        ValueError: shapes do not fit.
    """
    p, state = _checked(p, path, state)
    columns = np.empty(p.shape[-1] + len(STATE_NAMES))
    return _base_pose_sensitivities(p, state, *path, SIZE_THREE, columns)
