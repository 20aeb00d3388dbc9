"""Fast dynamics of the floating arm about its centre of mass, in absolute angles.

The coordinates are y = (c_x, c_y, psi_0 .. psi_n): the centre of mass c of the whole, and the
heading psi_k of each body's frame, u_k = exp(i psi_k). With kinematics.py's vectors in the bodies'
own frames, d_k = D_k u_k and e_k = E_k u_k, the mass M of all bodies and M_k of those beyond k,

    S_k = (D_k - b_k) u_k,   T_k = M b_k u_k,   M b_k = m_k E_k + M_k D_k

so that the base's origin is r_0 = c - sum_k T_k / M and r_{k+1} = r_k + S_k + T_k / M. The centre
of mass moves by itself, M c'' = F, and the angles by

    sum_j A_ij psi''_j = Q_i + sum_j B_ij psi'_j^2
    A_ij = A_ji = S_i . T_j,   B_ij = -B_ji = S_i x T_j                         for i < j
    A_ii = I_i + m_i |E_i|^2 + M_i |D_i|^2 - M |b_i|^2

The triangles of A consist of products of 2-vectors (A is semiseparable), and the terms that joints
add, as their rotors do, couple only neighbours. So A is factored and solved in O(n) and never
formed. Forces f_k on the pivots r_k (the last one is the tip) and torques n_k on the bodies give

    Q_k = n_k + S_k x (f_{k+1} + .. + f_{n+1}) - T_k / M x (f_0 + .. + f_k)

In-kernel functions take y, v = y' and a = y'' of (2 + m,), m = n + 1; Q starts with forces on c.
"""

import math
from typing import NamedTuple

import numpy as np

from .arrays import Complexes, Floats
from .kernels import helper, inlined
from .kinematics import body_com, body_inertia, body_mass, body_reach, cross, dot
from .layout import LINK_SIZE, MOUNT_ANGLE, OFFSET


class Bodies(NamedTuple):
    """Constants of base and links."""

    p: Floats  # Arm.vector()
    mass: float  # M
    arms: Complexes  # (2, m): D - b and M b
    inertia: Floats  # (2, m): diagonal of A, and the terms of joints in A_{k,k-1}


@helper
def scaled(a: float, z: complex) -> complex:
    """Return a z, without the products of a complex multiplication."""
    return complex(a * z.real, a * z.imag)


@helper
def make_bodies(p, rotor):  # type: ignore[no-untyped-def]
    """Return the Bodies of p (8 + 6 n,), contiguous, with each joint's rotor (N^2 J, N J).

    A rotor turns N times as fast as its joint, relative to the body before it. That body's inertia
    includes J. The rotor adds to the kinetic energy

        N^2 J (psi'_k - psi'_{k-1})^2 / 2 + N J psi'_{k-1} (psi'_k - psi'_{k-1})
    """
    m = p.size // LINK_SIZE  # integer division: the base has two numbers more than a link
    arms, inertia = np.empty((2, m), np.complex128), np.empty((2, m))
    M = 0.0
    for k in range(m):
        M += body_mass(p, k)
    beyond = M
    for k in range(m):
        mass = body_mass(p, k)
        beyond -= mass
        D, E = body_reach(p, k), body_com(p, k)
        Mb = scaled(mass, E) + scaled(beyond, D)
        arms[0, k], arms[1, k] = D - scaled(1.0 / M, Mb), Mb
        about_pivot = body_inertia(p, k) + mass * dot(E, E) + beyond * dot(D, D)
        inertia[0, k], inertia[1, k] = about_pivot - dot(Mb, Mb) / M, 0.0
    for k in range(1, m):
        inertia[0, k - 1] += rotor[0] - 2.0 * rotor[1]
        inertia[0, k] += rotor[0]
        inertia[1, k] = rotor[1] - rotor[0]
    return Bodies(p, M, arms, inertia)


@inlined
def turn_body(bodies, turned, k, u):  # type: ignore[no-untyped-def]
    """Write body k's column of turned (3, m), u with D - b and M b turned by it."""
    turned[0, k] = u
    turned[1, k], turned[2, k] = bodies.arms[0, k] * u, bodies.arms[1, k] * u


@helper
def _turn(bodies, z, turned):  # type: ignore[no-untyped-def]
    """Turn the bodies to the angles of y."""
    for k in range(turned.shape[1]):
        turn_body(bodies, turned, k, complex(math.cos(z[0, 2 + k]), math.sin(z[0, 2 + k])))


@inlined
def advance_rotation(bodies, start, z0, z, turned):  # type: ignore[no-untyped-def]
    """Turn the bodies to z from `start`, their state at z0: exact, and cheap for small turns.

    The truncation error of the series is below 0.0625^10 / 10!, 3e-19.
    """
    for k in range(turned.shape[1]):
        turn = z[0, 2 + k] - z0[0, 2 + k]
        if abs(turn) > 0.0625:
            u = complex(math.cos(z[0, 2 + k]), math.sin(z[0, 2 + k]))
        else:
            x = turn * turn
            c = 1.0 + x * (-1 / 2 + x * (1 / 24 + x * (-1 / 720 + x * (1 / 40320))))
            s = turn * (1.0 + x * (-1 / 6 + x * (1 / 120 + x * (-1 / 5040 + x * (1 / 362880)))))
            u = start[0, k] * complex(c, s)
        turn_body(bodies, turned, k, u)


@inlined
def write_rate(bodies, turned, force, torque, z, work, dz):  # type: ignore[no-untyped-def]
    """Write a for a force on the base's origin and torques on the bodies (m,); `work` is scratch.

    A = L diag(d) L^T with L_kj = T_k . w_j for j < k, plus R_k / d_{k-1} next to the diagonal; the
    R_k are the terms of joints. Rows share the sum P of d_j w_j w_j^T, a symmetric 2 x 2 matrix.
    """
    R, m = bodies.inertia, torque.size
    before = scaled(-1.0 / bodies.mass, force)  # less the terms psi'_j^2 S_j of bodies before k
    for i in range(2 + m):
        dz[0, i] = z[1, i]
    dz[1, 0], dz[1, 1] = -before.real, -before.imag
    beyond = 0j  # sum of psi'_j^2 T_j of bodies beyond k
    for k in range(m):
        beyond += scaled(z[1, 2 + k] * z[1, 2 + k], turned[2, k])
    g = last = 0j
    xx = xy = yy = forward = 0.0
    inverse = 1.0  # 1 / d_{k-1}
    for k in range(m):
        s, t, r = turned[1, k], turned[2, k], R[1, k]
        spin, beside = z[1, 2 + k] * z[1, 2 + k], r * inverse
        beyond -= scaled(spin, t)
        Q = torque[k] + cross(s, beyond) - cross(before, t)
        before += scaled(spin, s)
        Pt = complex(xx * t.real + xy * t.imag, xy * t.real + yy * t.imag) + scaled(r, last)
        inverse = 1.0 / (R[0, k] - r * (dot(t, last) + beside) - dot(t, Pt))
        forward = Q - dot(t, g) - beside * forward
        s -= Pt
        last = scaled(inverse, s)
        xx += s.real * last.real
        xy += s.real * last.imag
        yy += s.imag * last.imag
        g += scaled(forward, last)
        work[0, k], work[1, k], dz[1, 2 + k] = last, complex(beside, 0.0), forward * inverse
    back, beside, solved = 0j, 0.0, 0.0
    for k in range(m - 1, -1, -1):
        solved = dz[1, 2 + k] - dot(work[0, k], back) - beside * solved
        dz[1, 2 + k], beside = solved, work[1, k].real
        back += scaled(solved, turned[2, k])


@helper
def to_centroidal(bodies, q, qd, turned, z):  # type: ignore[no-untyped-def]
    """Write y and v of the state q, qd (3 + n,), and turn the bodies accordingly."""
    p = bodies.p
    z[0, 2], z[1, 2] = q[2], qd[2]
    for k in range(1, turned.shape[1]):
        mount = p[MOUNT_ANGLE] if k == 1 else 0.0
        z[0, 2 + k] = z[0, 1 + k] + p[LINK_SIZE * k + OFFSET] + q[2 + k] + mount
        z[1, 2 + k] = z[1, 1 + k] + qd[2 + k]
    _turn(bodies, z, turned)
    c, cd = complex(q[0], q[1]), complex(qd[0], qd[1])
    for k in range(turned.shape[1]):
        c += turned[2, k] / bodies.mass
        cd += 1j * scaled(z[1, 2 + k] / bodies.mass, turned[2, k])
    z[0, 0], z[0, 1], z[1, 0], z[1, 1] = c.real, c.imag, cd.real, cd.imag


@helper
def from_centroidal(bodies, turned, z, q, qd):  # type: ignore[no-untyped-def]
    """Write the state q, qd (3 + n,) of y and v; the bodies are already turned to y."""
    p = bodies.p
    r, rd = complex(z[0, 0], z[0, 1]), complex(z[1, 0], z[1, 1])
    for k in range(turned.shape[1]):
        r -= scaled(1.0 / bodies.mass, turned[2, k])
        rd -= 1j * scaled(z[1, 2 + k] / bodies.mass, turned[2, k])
    q[0], q[1], qd[0], qd[1] = r.real, r.imag, rd.real, rd.imag
    q[2], qd[2] = z[0, 2], z[1, 2]
    for k in range(1, turned.shape[1]):
        mount = p[MOUNT_ANGLE] if k == 1 else 0.0
        q[2 + k] = z[0, 2 + k] - z[0, 1 + k] - p[LINK_SIZE * k + OFFSET] - mount
        qd[2 + k] = z[1, 2 + k] - z[1, 1 + k]


@helper
def twice_energy_and_moment(bodies, turned, z):  # type: ignore[no-untyped-def]
    """Return twice the kinetic energy, and the angular momentum about the world's origin.

    2 T = M |c'|^2 + psi' . A psi',  L = M c x c' + sum_k (A psi')_k, rotors included.
    """
    R, m = bodies.inertia, turned.shape[1]
    r, v = complex(z[0, 0], z[0, 1]), complex(z[1, 0], z[1, 1])
    twice_energy, moment = bodies.mass * dot(v, v), bodies.mass * cross(r, v)
    spun, reach, last = 0j, 0j, 0.0  # over j < k: sum of psi'_j S_j, sum of S_j, psi'_{k-1}
    for k in range(m):
        S, T, omega = turned[1, k], turned[2, k], z[1, 2 + k]
        behind = dot(T, spun) + R[1, k] * last  # sum of A_kj psi'_j over j < k
        twice_energy += omega * (R[0, k] * omega + 2.0 * behind)
        moment += R[0, k] * omega + behind + omega * (dot(T, reach) + R[1, k])
        spun += scaled(omega, S)
        reach += S
        last = omega
    return twice_energy, moment
