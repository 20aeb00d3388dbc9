"""Dynamics of the free-floating system: H(q) qdd + h(q, qd) = tau, for x, y, theta, q_1 .. q_n.

In all functions p (..., 8 + 6 n) is Arm.vector(), q, qd, qdd (..., 3 + n) the state and its
derivatives, tau (..., 3 + n) the generalized forces: force on the base at its origin [N], torque on
it [N m] and joint torques [N m]. Leading dimensions broadcast. The notation is kinematics.py's.

Angles of bodies are sums of the coordinates, so that the absolute rates are sums too:

    phi'_k = theta' + q'_1 + .. + q'_k

H is computed with composite bodies, h and tau with recursive Newton-Euler equations, qdd with
articulated bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008), each specialized to the
plane. In-kernel functions, for one state and without allocation, take `work`, complex (3, n + 1),
as scratch memory.
"""

import numpy as np
import numpy.typing as npt

from .arrays import Complexes, Floats
from .kernels import helper, kernel
from .kinematics import body_inertia, body_mass, checked, cross, dot, write_chain


@helper
def join_bodies(
    p: Floats, k: int, d: Complexes, e: Complexes, M: float, S: complex, K: float
) -> tuple[float, complex, float]:
    """Return mass, first and second moment about pivot k of bodies k .. n, from k + 1 .. n."""
    m = body_mass(p, k)
    K += 2.0 * dot(d[k], S) + M * dot(d[k], d[k]) + body_inertia(p, k) + m * dot(e[k], e[k])
    return M + m, S + M * d[k] + m * e[k], K


@helper
def write_inertia(p: Floats, q: Floats, work: Complexes, H: Floats) -> None:
    """Write H (3 + n, 3 + n), by composite bodies.

    Bodies k .. n turn as one about pivot k, with first moment S_k and second moment K_k about it:

        H_kk = K_k,  H_ik = K_k + (r_k - r_i) . S_k,  H_xy,k = i S_k,  H_xy,xy = M_0
    """
    d, e = work[0], work[1]
    write_chain(p, q, d, e)
    M, S, K = 0.0, 0j, 0.0
    for k in range(d.size - 1, -1, -1):
        M, S, K = join_bodies(p, k, d, e, M, S, K)
        H[0, 2 + k] = H[2 + k, 0] = -S.imag
        H[1, 2 + k] = H[2 + k, 1] = S.real
        H[2 + k, 2 + k] = K
        reach = 0j
        for i in range(k - 1, -1, -1):
            reach += d[i]
            H[2 + i, 2 + k] = H[2 + k, 2 + i] = K + dot(reach, S)
    H[0, 0] = H[1, 1] = M
    H[0, 1] = H[1, 0] = 0.0


@helper
def _inverse(p: Floats, q: Floats, qd: Floats, qdd: Floats, work: Complexes, tau: Floats) -> None:
    """Write tau (3 + n,), by the recursive Newton-Euler equations; tau may be qdd itself.

    The force on body k and the moment at its pivot, F_k being the sum of f_k .. f_n:

        f_k = m_k (a_k + (i alpha_k - omega_k^2) e_k)
        T_k = T_{k+1} + d_k x F_{k+1} + e_k x f_k + I_k alpha_k
    """
    d, e, f = work[0], work[1], work[2]
    write_chain(p, q, d, e)
    a = complex(qdd[0], qdd[1])
    omega = alpha = 0.0
    for k in range(d.size):
        omega += qd[2 + k]
        alpha += qdd[2 + k]
        turn = complex(-omega * omega, alpha)
        f[k] = body_mass(p, k) * (a + turn * e[k])
        a += turn * d[k]
        tau[2 + k] = body_inertia(p, k) * alpha
    F, T = 0j, 0.0
    for k in range(d.size - 1, -1, -1):
        T += cross(d[k], F) + cross(e[k], f[k]) + tau[2 + k]
        F += f[k]
        tau[2 + k] = T
    tau[0], tau[1] = F.real, F.imag


@helper
def write_bias(p: Floats, q: Floats, qd: Floats, work: Complexes, h: Floats) -> None:
    """Write h (3 + n,): the forces that keep every coordinate from accelerating."""
    h[:] = 0.0
    _inverse(p, q, qd, h, work, h)


@helper
def _forward(p: Floats, q: Floats, qd: Floats, tau: Floats, work: Complexes, qdd: Floats) -> None:
    """Write qdd (3 + n,), by articulated bodies.

    With the joint torque given, link k reacts to an acceleration a of its pivot with

        angular acceleration  alpha = s - w . a
        force at the pivot    N a + b,   N = M - u u^T / K (symmetric), w = u / K

    where M, u, K are its inertia about the pivot including all further links. So N and b are passed
    from the tip to the base, and accelerations back.
    """
    d, e, w = work[0], work[1], work[2]
    write_chain(p, q, d, e)
    omega = 0.0
    for k in range(d.size):
        omega += qd[2 + k]
        qdd[2 + k] = omega * omega
    xx = xy = yy = 0.0  # N of the links beyond the next joint
    b = 0j
    beyond = 0.0  # torque of the next joint, which acts on link k with opposite sign
    for k in range(d.size - 1, -1, -1):
        m, spin = body_mass(p, k), qdd[2 + k]
        b -= spin * complex(xx * d[k].real + xy * d[k].imag, xy * d[k].real + yy * d[k].imag)
        Nd = complex(xy * d[k].real - xx * d[k].imag, yy * d[k].real - xy * d[k].imag)  # N (i d)
        u = 1j * m * e[k] + Nd
        K = body_inertia(p, k) + m * dot(e[k], e[k]) + cross(d[k], Nd)
        s = (tau[2 + k] - beyond - cross(d[k], b)) / K
        beyond = tau[2 + k]
        w[k], qdd[2 + k] = u / K, s
        b += u * s - spin * m * e[k]
        xx += m - u.real * w[k].real
        xy -= u.real * w[k].imag
        yy += m - u.imag * w[k].imag
    F = complex(tau[0], tau[1]) - b
    a = complex(yy * F.real - xy * F.imag, xx * F.imag - xy * F.real) / (xx * yy - xy * xy)
    qdd[0], qdd[1] = a.real, a.imag
    omega = before = 0.0
    for k in range(d.size):
        omega += qd[2 + k]
        alpha = qdd[2 + k] - dot(w[k], a)
        a += complex(-omega * omega, alpha) * d[k]
        qdd[2 + k] = alpha - before
        before = alpha


@kernel("(p),(m)->(m,m)")
def _inertia_matrix(p: Floats, q: Floats, H: Floats) -> None:
    write_inertia(p, q, np.empty((3, q.size - 2), np.complex128), H)


@kernel("(p),(m),(m)->(m)")
def _bias_forces(p: Floats, q: Floats, qd: Floats, h: Floats) -> None:
    write_bias(p, q, qd, np.empty((3, q.size - 2), np.complex128), h)


@kernel("(p),(m),(m),(m)->(m)")
def _inverse_dynamics(p: Floats, q: Floats, qd: Floats, qdd: Floats, tau: Floats) -> None:
    _inverse(p, q, qd, qdd, np.empty((3, q.size - 2), np.complex128), tau)


@kernel("(p),(m),(m),(m)->(m)")
def _forward_dynamics(p: Floats, q: Floats, qd: Floats, tau: Floats, qdd: Floats) -> None:
    _forward(p, q, qd, tau, np.empty((3, q.size - 2), np.complex128), qdd)


@kernel("(p),(m),(m)->()")
def _kinetic_energy(p: Floats, q: Floats, qd: Floats, out: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    v, omega, energy = complex(qd[0], qd[1]), 0.0, 0.0
    for k in range(d.size):
        omega += qd[2 + k]
        c = v + 1j * omega * e[k]
        energy += 0.5 * (body_mass(p, k) * dot(c, c) + body_inertia(p, k) * omega * omega)
        v += 1j * omega * d[k]
    out[0] = energy


def inertia_matrix(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return the generalized inertia matrix H, (..., 3 + n, 3 + n), kg, kg m, kg m^2; O(n^2).

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _inertia_matrix(p, q)


def bias(p: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike) -> Floats:
    """Return Coriolis and centrifugal forces h(q, qd) = C(q, qd) qd, (..., 3 + n) [N, N m]; O(n).

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _bias_forces(p, q, qd)


def inverse_dynamics(
    p: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike, qdd: npt.ArrayLike
) -> Floats:
    """Return generalized forces tau = H qdd + h, (..., 3 + n) [N, N m]; O(n).

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _inverse_dynamics(p, q, qd, qdd)


def forward_dynamics(
    p: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike, tau: npt.ArrayLike
) -> Floats:
    """Return accelerations H^-1 (tau - h), (..., 3 + n) [m/s^2, rad/s^2]; O(n), without forming H.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _forward_dynamics(p, q, qd, tau)


def kinetic_energy(p: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike) -> Floats:
    """Return T = sum over bodies of (m |v|^2 + I omega^2) / 2 = qd' H qd / 2, (...) [J].

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _kinetic_energy(p, q, qd)
