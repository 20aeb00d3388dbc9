"""Momentum of the free-floating system, and the generalized Jacobian of its arm.

In all functions p (..., 8 + 6 n) is Arm.vector(), q and qd (..., 3 + n) the state and its rate.
Leading dimensions broadcast. The notation is that of kinematics.py.
"""

import numpy as np
import numpy.typing as npt

from .arrays import Complexes, Floats
from .dynamics import join_bodies
from .kernels import helper, kernel
from .kinematics import (
    SIZE_THREE,
    SIZE_TWO,
    body_inertia,
    body_mass,
    checked,
    cross,
    dot,
    write_chain,
)


@kernel("(p),(m),(w)->(w)")
def _system_com(p: Floats, q: Floats, _w: Floats, out: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    M, S, r = 0.0, 0j, 0j
    for k in range(d.size):
        m = body_mass(p, k)
        M += m
        S += m * (r + e[k])
        r += d[k]
    out[0], out[1] = q[0] + S.real / M, q[1] + S.imag / M


@kernel("(p),(m),(m),(t)->(t)")
def _momentum(p: Floats, q: Floats, qd: Floats, _t: Floats, out: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    r, v, omega = 0j, complex(qd[0], qd[1]), 0.0  # of pivot k, relative to the base's origin
    M, S, P, L = 0.0, 0j, 0j, 0.0
    for k in range(d.size):
        omega += qd[2 + k]
        m, c = body_mass(p, k), r + e[k]
        f = m * (v + 1j * omega * e[k])
        M += m
        S += m * c
        P += f
        L += cross(c, f) + body_inertia(p, k) * omega
        r += d[k]
        v += 1j * omega * d[k]
    out[0], out[1], out[2] = P.real, P.imag, L - cross(S / M, P)


@helper
def write_floating_jacobian(p: Floats, d: Complexes, e: Complexes, J: Floats) -> None:
    """Write the generalized Jacobian (3, n), without allocation, from the bodies' d and e."""
    tip, M, S, K = 0j, 0.0, 0j, 0.0
    for k in range(d.size - 1, -1, -1):
        M, S, K = join_bodies(p, k, d, e, M, S, K)
        tip += d[k]
        if k > 0:
            J[0, k - 1], J[1, k - 1], J[2, k - 1] = S.real, S.imag, K
    com = S / M
    moment = K - dot(com, S)  # of the whole system about its centre of mass
    r = 0j
    for k in range(1, d.size):
        r += d[k - 1]
        S_k, K_k = complex(J[0, k - 1], J[1, k - 1]), J[2, k - 1]
        omega = -(K_k + dot(r - com, S_k)) / moment  # of the base, so that momentum stays zero
        v = -1j * (omega * com + S_k / M)
        v += 1j * (omega * tip + tip - r)
        J[0, k - 1], J[1, k - 1], J[2, k - 1] = v.real, v.imag, omega + 1.0


@kernel("(p),(m),(t),(n)->(t,n)")
def _generalized_jacobian(p: Floats, q: Floats, _t: Floats, _n: Floats, J: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    write_floating_jacobian(p, d, e, J)


def system_com(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return the centre of mass of base and arm in the world, (..., 2) [m].

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _system_com(p, q, SIZE_TWO)


def momentum(p: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike) -> Floats:
    """Return momentum (px, py, L), L about the system's centre of mass, (..., 3) [N s, N m s].

        P = sum m_k v_k,   L = sum (c_k - c) x m_k v_k + I_k omega_k

    All three are constant while no external force acts.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _momentum(p, q, qd, SIZE_THREE)


def generalized_jacobian(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return the Jacobian from joint rates to tip twist for a floating base and zero momentum.

        J* = J_m - J_b H_b^-1 H_bm                                (Umetani & Yoshida 1989)

    H_b is inverted in closed form: with H taken about the system's centre of mass it is diagonal.

    Returns:
        (..., 3, n), the twist (vx, vy, omega) in world axes. It tends to J_m as the base's mass
        and inertia grow.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, n = checked(p, q)
    return _generalized_jacobian(p, q, SIZE_THREE, np.empty(n))
