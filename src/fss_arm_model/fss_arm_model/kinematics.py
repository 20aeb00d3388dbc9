"""Kinematics: joints, centres of mass, the end effector and its Jacobians (Eq. 1).

In all functions p (..., 8 + 6 n) is Arm.vector(), q (..., 3 + n) the state (x, y, theta,
q_1 .. q_n) in m and rad, q_m (..., n) its joint part. Leading dimensions broadcast, so one state,
a batch of states and a batch of arms are the same call.

Planar vectors are complex numbers in the kernels: a turn by phi is a product with exp(i phi), the
velocity of an arm r turning at omega is i omega r, a x b is Im(conj(a) b) and a . b its real part.
Body k has its pivot r_k (0: the base and its frame's origin, k: link k and joint k), and

    d_k = r_{k+1} - r_k      from its pivot to the next, for the last link to the tip
    e_k = c_k - r_k          from its pivot to its centre of mass
"""

import math

import numpy as np
import numpy.typing as npt

from . import layout
from .arrays import Complexes, Floats
from .kernels import helper, kernel
from .layout import LENGTH, LINK_SIZE, MOUNT_ANGLE, OFFSET, TIP_ANGLE

body_mass, body_inertia = helper(layout.mass), helper(layout.inertia)
body_reach, body_com = helper(layout.reach), helper(layout.com)


@helper
def dot(a: complex, b: complex) -> float:
    """Return the scalar product of two plane vectors."""
    return a.real * b.real + a.imag * b.imag


@helper
def cross(a: complex, b: complex) -> float:
    """Return the z component of the vector product of two plane vectors."""
    return a.real * b.imag - a.imag * b.real


@helper
def write_chain(p: Floats, q: Floats, d: Complexes, e: Complexes) -> float:
    """Write d and e of every body, complex (n + 1,); return the tip's heading."""
    heading = q[2]
    turn = complex(math.cos(heading), math.sin(heading))
    d[0], e[0] = body_reach(p, 0) * turn, body_com(p, 0) * turn
    heading += p[MOUNT_ANGLE]
    for k in range(1, q.size - 2):
        heading += p[LINK_SIZE * k + OFFSET] + q[2 + k]
        turn = complex(math.cos(heading), math.sin(heading))
        d[k], e[k] = p[LINK_SIZE * k + LENGTH] * turn, body_com(p, k) * turn
    return heading + p[TIP_ANGLE]


@kernel("(p),(m),(j),(w)->(j,w)")
def _joint_positions(p: Floats, q: Floats, _j: Floats, _w: Floats, out: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    r = complex(q[0], q[1])
    for k in range(d.size):
        r += d[k]
        out[k, 0], out[k, 1] = r.real, r.imag


@kernel("(p),(m),(j),(w)->(j,w)")
def _com_positions(p: Floats, q: Floats, _j: Floats, _w: Floats, out: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    r = complex(q[0], q[1])
    for k in range(d.size):
        c = r + e[k]
        out[k, 0], out[k, 1] = c.real, c.imag
        r += d[k]


@kernel("(p),(m),(t)->(t)")
def _tip_pose(p: Floats, q: Floats, _t: Floats, out: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    out[2] = write_chain(p, q, d, e)
    tip = complex(q[0], q[1])
    for k in range(d.size):
        tip += d[k]
    out[0], out[1] = tip.real, tip.imag


@kernel("(p),(m),(t)->(t,m)")
def _tip_jacobian(p: Floats, q: Floats, _t: Floats, J: Floats) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    write_chain(p, q, d, e)
    J[:, 0], J[:, 1], J[2, 2:] = 0.0, 0.0, 1.0
    J[0, 0] = J[1, 1] = 1.0
    arm = 0j  # from pivot k to the tip
    for k in range(d.size - 1, -1, -1):
        arm += d[k]
        J[0, 2 + k], J[1, 2 + k] = -arm.imag, arm.real


@kernel("(p),(m),(t),(x)->(t,x)")
def _tip_regressor(p: Floats, q: Floats, _t: Floats, _x: Floats, Phi: Floats) -> None:
    n = q.size - 3
    d, e = np.empty((2, n + 1), np.complex128)
    write_chain(p, q, d, e)
    Phi[:] = 0.0
    arm = 0j
    for k in range(n, 0, -1):
        length = p[LINK_SIZE * k + LENGTH]
        arm += d[k]
        Phi[0, k - 1], Phi[1, k - 1] = d[k].real / length, d[k].imag / length
        column = n + k - 2 if k > 1 else 2 * n + 1
        Phi[0, column], Phi[1, column], Phi[2, column] = -arm.imag, arm.real, 1.0
    Phi[0, 2 * n - 1] = Phi[1, 2 * n] = 1.0


# Arguments without a value, whose sizes are those of kernels' outputs.
SIZE_TWO, SIZE_THREE = np.empty(2), np.empty(3)


def checked(p: npt.ArrayLike, q: npt.ArrayLike) -> tuple[Floats, Floats, int]:
    """Return the arrays p and q, and n.

    Raises:
        ValueError: their last dimensions do not fit the same number of links.
    """
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    n = q.shape[-1] - 3 if q.ndim else -1
    if n < 0 or p.ndim == 0 or p.shape[-1] != layout.size(n):
        expected = "(..., 8 + 6 n) and (..., 3 + n) with n of 0 or more"
        raise ValueError(f"p and q have the shapes {p.shape} and {q.shape}, expected {expected}")
    return p, q, n


def _with_base_at_origin(q_m: npt.ArrayLike) -> Floats:
    """Return the state with its base at the origin."""
    q_m = np.asarray(q_m, dtype=float)
    return np.concatenate([np.zeros((*q_m.shape[:-1], 3)), q_m], axis=-1)


def joint_positions(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return joints 1 to n and the tip in the world [m]: r_{k+1} = r_k + d_k.

    Returns:
        (..., n + 1, 2), the tip last.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, n = checked(p, q)
    return _joint_positions(p, q, np.empty(n + 1), SIZE_TWO)


def com_positions(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return centres of mass in the world [m]: c_k = r_k + e_k.

    Returns:
        (..., n + 1, 2), the base first.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, n = checked(p, q)
    return _com_positions(p, q, np.empty(n + 1), SIZE_TWO)


def tip_pose(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return the end effector's pose in the world, (..., 3): x, y [m], heading [rad], not wrapped.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _tip_pose(p, q, SIZE_THREE)


def tip_jacobian(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return J = [J_b | J_m]: the end effector's twist (vx, vy, omega) in world axes is J qd.

    Returns:
        (..., 3, 3 + n).

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _tip_jacobian(p, q, SIZE_THREE)


def tip_in_base(p: npt.ArrayLike, q_m: npt.ArrayLike) -> Floats:
    """Return the end effector's pose in the base frame (Eq. 1), (..., 3): x, y [m], heading [rad].

        x_EE = k(theta, theta_0, a, x_BJ1, y_BJ1, theta_BJ1)

    Raises:
        ValueError: shapes do not fit.
    """
    return tip_pose(p, _with_base_at_origin(q_m))


def tip_regressor(p: npt.ArrayLike, q_m: npt.ArrayLike) -> Floats:
    """Return Phi of Eq. 5: derivative of tip_in_base by the parameters of kinematic_names(n).

    Returns:
        (..., 3, 2 n + 2). Eq. 3 stacks these rows for the observations.

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, n = checked(p, _with_base_at_origin(q_m))
    return _tip_regressor(p, q, SIZE_THREE, np.empty(2 * n + 2))


def reading_jacobian(p: npt.ArrayLike, q_m: npt.ArrayLike) -> Floats:
    """Return the derivative of tip_in_base by the readings, (..., 3, n).

    It equals the derivative by the joints' offsets.
    """
    Phi = tip_regressor(p, q_m)
    n = Phi.shape[-1] // 2 - 1
    return Phi[..., [2 * n + 1, *range(n, 2 * n - 1)]]
