"""Joint torques of the arm on a floating base, with the base's motion eliminated.

No force acts on the base. Its angular rate follows from the angular momentum L about the system's
centre of mass, its acceleration from the first three rows of H qdd + h = 0. The uniform motion of
the whole system changes no torque. With S_k and K_k of dynamics.py and c the centre of mass,

    omega = (L - N J sum_k q'_k) / K_c + G q',   G_k = -(K_k + (r_k - c) . S_k) / K_c
    K_c = K_0 - M |c|^2

G is the angular coupling. Each joint has a rotor of inertia J, which turns N times as fast as the
joint relative to the body before it. It adds N^2 J q''_k + N J (theta'' + sum_j q''_j - q''_k) to
tau_k.
"""

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .dynamics import join_bodies
from .kernels import helper, kernel
from .kinematics import body_inertia, body_mass, checked, cross, dot, write_chain


@helper
def write_geometry(p, state, work, second):  # type: ignore[no-untyped-def]
    """Write d, e, S_k and K_k at the joints of a state (3 + n,); set its base to the origin.

    Returns:
        Mass, centre of mass and moment about it, of the whole system.
    """
    d, e = work[0], work[1]
    state[0] = state[1] = state[2] = 0.0
    write_chain(p, state, d, e)
    M, S, K = 0.0, 0j, 0.0
    for k in range(d.size - 1, -1, -1):
        M, S, K = join_bodies(p, k, d, e, M, S, K)
        second[0, k], second[1, k] = S, complex(K, 0.0)
    return M, S / M, K - dot(S, S) / M


@helper
def write_free_torques(p, rotor, L, geometry, rate, gain, work, second, tau):  # type: ignore[no-untyped-def]
    """Write tau (3 + n,), with the first three 0; return the base's angular rate.

    rate and gain (3 + n,) contain the joints' part; the base's part is overwritten. work (3, n + 1)
    and second (2, n + 1) come from write_geometry.
    """
    M, com, about_com = geometry
    d, e, f = work[0], work[1], work[2]
    n, r, spun, sped = d.size - 1, 0j, 0.0, 0.0
    for i in range(3):
        rate[i] = gain[i] = 0.0
    omega = L
    for k in range(1, n + 1):
        r += d[k - 1]
        omega -= (second[1, k].real + dot(r - com, second[0, k])) * rate[2 + k]
        spun += rate[2 + k]
        sped += gain[2 + k]
    omega = (omega - rotor[1] * spun) / about_com
    rate[2] = omega
    # Newton-Euler equations with a base that does not accelerate
    a, turning, alpha = 0j, 0.0, 0.0
    for k in range(n + 1):
        turning += rate[2 + k]
        alpha += gain[2 + k]
        turn = complex(-turning * turning, alpha)
        f[k] = body_mass(p, k) * (a + turn * e[k])
        a += turn * d[k]
        tau[2 + k] = body_inertia(p, k) * alpha
    F, T = 0j, 0.0
    for k in range(n, -1, -1):
        T += cross(d[k], F) + cross(e[k], f[k]) + tau[2 + k]
        F += f[k]
        tau[2 + k] = T
    # effect of the base's acceleration
    alpha = -(T + rotor[1] * sped - cross(com, F)) / about_com
    a = -F / M - 1j * alpha * com
    r, before = 0j, alpha
    for k in range(1, n + 1):
        r += d[k - 1]
        tau[2 + k] += dot(1j * second[0, k], a)
        tau[2 + k] += (second[1, k].real + dot(r, second[0, k])) * alpha
        sped -= gain[2 + k]
        tau[2 + k] += rotor[0] * gain[2 + k] + rotor[1] * (before + sped)
        before += gain[2 + k]
    tau[0] = tau[1] = tau[2] = 0.0
    return omega


@kernel("(p),(n),(n),(n),(),(r)->(n),()")
def _torques(p, q_m, qd_m, qdd_m, L, rotor, tau_m, omega):  # type: ignore[no-untyped-def]
    n = q_m.size
    state, rate, gain, tau = np.empty((4, 3 + n))
    work, second = np.empty((3, n + 1), np.complex128), np.empty((2, n + 1), np.complex128)
    state[3:], rate[3:], gain[3:] = q_m, qd_m, qdd_m
    geometry = write_geometry(p, state, work, second)
    omega[0] = write_free_torques(p, rotor, L[0], geometry, rate, gain, work, second, tau)
    tau_m[:] = tau[3:]


def free_torques(
    p: npt.ArrayLike,
    q_m: npt.ArrayLike,
    qd_m: npt.ArrayLike,
    qdd_m: npt.ArrayLike,
    momentum: npt.ArrayLike = 0.0,
    rotor: npt.ArrayLike = (0.0, 0.0),
) -> tuple[Floats, Floats]:
    """Return joint torques of the floating arm, (..., n) [N m], and the base's rate [rad/s].

    Args:
        p: (..., 8 + 6 n) Arm.vector().
        q_m: (..., n) joint readings [rad].
        qd_m: (..., n) their rates [rad/s].
        qdd_m: (..., n) their accelerations [rad/s^2].
        momentum: L, (...) [N m s], rotors included.
        rotor: (2,) N^2 J and N J [kg m^2].

    Raises:
        ValueError: shapes do not fit.
    """
    q_m = np.asarray(q_m, dtype=float)
    p, _, _ = checked(p, np.concatenate([np.zeros((*q_m.shape[:-1], 3)), q_m], axis=-1))
    return _torques(p, q_m, qd_m, qdd_m, momentum, np.asarray(rotor, dtype=float))
