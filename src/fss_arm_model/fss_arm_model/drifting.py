"""Drift of base and arm as one rigid body while the arm rests: on a tilted table, with a hose.

The body has mass M and inertia K about its centre of mass, which is at c in the base's frame. With
the base's origin, where the hose is, at x, its heading theta, and z = x + exp(i theta) c,

    M z'' = M g - d x'        K theta'' = tau - kappa theta' + (x - z) x (-d x')

g is the acceleration of a free body down the table, tau the hose's torque at rest, kappa and d its
damping of rotation and translation. Planar vectors are complex numbers.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .dynamics import inertia_matrix
from .kernels import helper, kernel
from .momentum import system_com

SURROUNDINGS = ("g_x", "g_y", "torque", "twist_damping", "drag")
BODY = ("mass", "inertia", "x", "y")  # of base and arm as one body; x, y: its centre of mass

SHARED_COUNT, STATE_COUNT = 5, 6  # unknowns: SURROUNDINGS; pose and twist at the start
BODY_INDICES = [13, 14, 11, 12]  # indices of BODY after these unknowns

#: Half differences for numerical derivatives by SURROUNDINGS, pose, twist, centre of mass, mass and
#: inertia: far above rounding, with negligible curvature.
DIFFERENCE_STEPS = np.array(
    [1e-5, 1e-5, 3e-7, 1e-5, 1e-4, *[1e-3] * 3, 1e-4, 1e-4, 1e-5, *[1e-3] * 2, 1e-3, 1e-4]
)

_FOUR = np.empty(4)
_MAX_TURN = 0.1  # largest rotation in a step of the integration [rad]


@helper
def _rates(M, K, c, shared, u, theta, omega):  # type: ignore[no-untyped-def]
    """Return the accelerations of the centre of mass and of the heading."""
    arm = complex(math.cos(theta), math.sin(theta)) * c
    v = u - 1j * omega * arm  # velocity of the base's origin
    by_drag = shared[4] * (arm.real * v.imag - arm.imag * v.real)
    g = complex(shared[0], shared[1])
    return g - shared[4] / M * v, (shared[2] - shared[3] * omega + by_drag) / K


@kernel("(b),(s),(o),(m),(f)->(m,f)")
def _drift(body, shared, own, times, _f, out):  # type: ignore[no-untyped-def]
    M, K, c = body[0], body[1], complex(body[2], body[3])
    theta, omega = own[2], own[5]
    lever = complex(math.cos(theta), math.sin(theta)) * c
    z = complex(own[0], own[1]) + lever
    u = complex(own[3], own[4]) + 1j * omega * lever
    for i in range(times.size):
        span = times[i] - times[i - 1] if i > 0 else 0.0
        count = max(1, math.ceil(abs(omega) * span / _MAX_TURN)) if span > 0.0 else 0
        for _ in range(count):  # Runge-Kutta method of fourth order
            h = span / count
            a1, b1 = _rates(M, K, c, shared, u, theta, omega)
            u2, w2 = u + 0.5 * h * a1, omega + 0.5 * h * b1
            a2, b2 = _rates(M, K, c, shared, u2, theta + 0.5 * h * omega, w2)
            u3, w3 = u + 0.5 * h * a2, omega + 0.5 * h * b2
            a3, b3 = _rates(M, K, c, shared, u3, theta + 0.5 * h * w2, w3)
            u4, w4 = u + h * a3, omega + h * b3
            a4, b4 = _rates(M, K, c, shared, u4, theta + h * w3, w4)
            z += h / 6.0 * (u + 2.0 * u2 + 2.0 * u3 + u4)
            theta += h / 6.0 * (omega + 2.0 * w2 + 2.0 * w3 + w4)
            u += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            omega += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
        x = z - complex(math.cos(theta), math.sin(theta)) * c
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = x.real, x.imag, theta, omega


def drift(
    body: npt.ArrayLike, shared: npt.ArrayLike, own: npt.ArrayLike, times: npt.ArrayLike
) -> Floats:
    """Return pose and turn rate of the base, (..., m, 4): x, y [m], heading [rad], rate [rad/s].

    Args:
        body: (..., 4) as BODY [kg, kg m^2, m, m].
        shared: (..., 5) as SURROUNDINGS [m/s^2, m/s^2, N m, N m s, N s/m].
        own: (..., 6) pose and twist at the first time.
        times: (..., m) times, ascending [s].
    """
    return _drift(body, shared, own, times, _FOUR)


class Sensitivity(NamedTuple):
    """Predicted drift, with derivatives by the first k of its unknowns."""

    poses: Floats  # (m, 3)
    poses_by: Floats  # (m, 3, k)
    spin: float  # gain of angular momentum during the drift [N m s]
    spin_by: Floats  # (k,)


def sensitivities(times: npt.ArrayLike, unknowns: Floats, k: int) -> Sensitivity:
    """Predict a drift from its 15 unknowns, as in DIFFERENCE_STEPS; differentiate by the first k.

    The times (m,) are ascending [s].
    """
    steps = np.eye(k, len(unknowns)) * DIFFERENCE_STEPS
    u = unknowns + np.concatenate([np.zeros((1, len(unknowns))), steps, -steps])
    own = u[:, SHARED_COUNT : SHARED_COUNT + STATE_COUNT]
    found = drift(u[:, BODY_INDICES], u[:, :SHARED_COUNT], own, np.array(times))
    spin = u[:, BODY_INDICES[1]] * (found[:, -1, 3] - own[:, 5])
    poses, width = found[..., :3], 2.0 * DIFFERENCE_STEPS[:k]
    poses_by = np.moveaxis(poses[1 : k + 1] - poses[k + 1 :], 0, -1) / width
    spin_by = (spin[1 : k + 1] - spin[k + 1 :]) / width
    return Sensitivity(poses[0], poses_by, float(spin[0]), spin_by)


def single_body(p: npt.ArrayLike, q: npt.ArrayLike) -> Floats:
    """Return base and arm, Arm.vector(), at readings (..., n) as one body, (..., 4) as BODY."""
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    state = np.concatenate([np.zeros((*q.shape[:-1], 3)), q], axis=-1)
    H, com = inertia_matrix(p, state), system_com(p, state)
    mass = H[..., 0, 0]
    inertia = H[..., 2, 2] - mass * np.sum(com**2, axis=-1)
    return np.concatenate([np.stack([mass, inertia], axis=-1), com], axis=-1)


def single_body_sensitivities(p: Floats, q: npt.ArrayLike) -> Floats:
    """Return derivatives of single_body by Arm.vector(), (..., 4, 8 + 6 n), at q (..., n)."""
    step = 1e-6
    moved = p + step * np.concatenate([np.eye(p.size), -np.eye(p.size)])
    bodies = single_body(moved, np.asarray(q, dtype=float)[..., None, :])
    by = (bodies[..., : p.size, :] - bodies[..., p.size :, :]) / (2.0 * step)
    return np.swapaxes(by, -1, -2)
