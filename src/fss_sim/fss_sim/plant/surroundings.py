"""External forces on the floating arm: table, air film, tether and thrusters."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.centroidal import scaled, twice_energy_and_moment, write_rate
from fss_arm_model.extents import Extents
from fss_arm_model.kernels import helper, inlined
from fss_arm_model.kinematics import cross, dot
from fss_arm_model.settings import FINITE, NOT_NEGATIVE, Settings, like, setting
from fss_arm_model.units import GRAVITY

# Indices of Surroundings.vector(). The shear of the air film grows with the mass that it carries:
# the force on each mass element m is -film m v. Without air the pads lie on the table and rub, with
# a friction that does not depend on the speed. It is distributed over the mass elements as the
# film's shear is, with
#
#     film = friction g / sqrt(V^2 + CREEP^2),   V^2 = 2 T / M
#
# in its place, so that its power is friction M g V, as by Coulomb's law for a sliding body.
TILT_X, TILT_Y, FILM, TETHER, TWIST, HALF_X, HALF_Y = range(7)
STIFFNESS, DAMPING, BASE_RADIUS, LINK_RADIUS, PADS = range(7, 12)
CREEP = 0.01  # speed below which the friction of pads on the table falls, to 0 at rest [m/s]


@dataclass(frozen=True)
class Surroundings(Settings):
    """External forces on floating bodies; by default only the table's border."""

    tilt: tuple[float, ...] = setting(
        (0.0, 0.0),
        "tilt of the table; positive: it falls towards +x, +y",
        unit="rad",
        check=FINITE,
        size=2,
    )
    film: float = setting(
        0.0,
        "damping by the air films, per mass carried and velocity",
        unit="1/s",
        check=NOT_NEGATIVE,
    )
    tether: float = setting(
        0.0, "drag of the hose on the base's origin", unit="N s/m", check=NOT_NEGATIVE
    )
    tether_twist: float = setting(
        0.0, "resistance of the hose to the base's rotation", unit="N m s", check=NOT_NEGATIVE
    )
    table: tuple[float, ...] = like(Extents, "table")
    border_stiffness: float = setting(
        2000.0, "stiffness of the table's border", unit="N/m", check=NOT_NEGATIVE
    )
    border_damping: float = setting(
        100.0, "damping of the table's border", unit="N s/m", check=NOT_NEGATIVE
    )
    base_radius: float = like(Extents, "base_radius")
    link_radius: float = like(Extents, "link_radius")
    pad_friction: float = setting(
        0.2, "friction coefficient of air bearings without air on the table", check=NOT_NEGATIVE
    )

    def vector(self, floats: bool = True) -> Floats:
        """Return the parameters that the kernel uses, (12,).

        The tilt is given as an acceleration, the table by half its size.
        `floats`: whether the bearings have air.
        """
        tilt, half = GRAVITY * np.array(self.tilt), 0.5 * np.array(self.table)
        border = self.border_stiffness, self.border_damping, self.base_radius, self.link_radius
        pads = 0.0 if floats else GRAVITY * self.pad_friction
        return np.array([*tilt, self.film, self.tether, self.tether_twist, *half, *border, pads])


@helper
def _push(around, r, v, radius):  # type: ignore[no-untyped-def]
    """Return the border's force on a disc at r that moves at v; it pushes and never pulls."""
    stiffness, damping = around[STIFFNESS], around[DAMPING]
    x = y = 0.0
    deep = abs(r.real) + radius - around[HALF_X]
    if deep > 0.0:
        out = math.copysign(1.0, r.real)
        x = -out * max(0.0, stiffness * deep + damping * out * v.real)
    deep = abs(r.imag) + radius - around[HALF_Y]
    if deep > 0.0:
        out = math.copysign(1.0, r.imag)
        y = -out * max(0.0, stiffness * deep + damping * out * v.imag)
    return complex(x, y)


@helper
def _is_near_edge(bodies, around, z):  # type: ignore[no-untyped-def]
    """Return True if a part may touch the border, judged by an upper bound of the reach."""
    reach = max(around[BASE_RADIUS], around[LINK_RADIUS])
    for k in range(bodies.arms.shape[1]):
        ahead, back = bodies.arms[0, k], bodies.arms[1, k] / bodies.mass
        reach += max(abs(ahead.real) + abs(ahead.imag), abs(back.real) + abs(back.imag))
    far_x = abs(z[0, 0]) + reach > around[HALF_X]
    return far_x or abs(z[0, 1]) + reach > around[HALF_Y]


@helper
def _border(bodies, around, turned, z, torque):  # type: ignore[no-untyped-def]
    """Add the border's forces on base, joints and tip to the torques; return their sum.

    A force f at a pivot equals f on the base's origin plus torques d_k x f on the bodies before it.
    """
    m, mass = torque.size, bodies.mass
    r, v = complex(z[0, 0], z[0, 1]), complex(z[1, 0], z[1, 1])
    for k in range(m):
        r -= scaled(1.0 / mass, turned[2, k])
        v -= 1j * scaled(z[1, 2 + k] / mass, turned[2, k])
    force = _push(around, r, v, around[BASE_RADIUS])
    for k in range(m):
        d = turned[1, k] + scaled(1.0 / mass, turned[2, k])
        r += d
        v += 1j * scaled(z[1, 2 + k], d)
        if m > 1:
            push = _push(around, r, v, around[LINK_RADIUS])
            force += push
            for j in range(k + 1):
                back = turned[1, j] + scaled(1.0 / mass, turned[2, j])
                torque[j] += cross(back, push)
    return force


class Forces(NamedTuple):
    """Forces and torques on the bodies in a step."""

    around: Floats  # (12,) Surroundings.vector()
    thrust: complex  # on the base's origin, in the base frame [N]
    held: Floats  # (m,) torques on the bodies [N m]
    torque: Floats  # (m,) scratch


@inlined
def write_derivative(bodies, forces, turned, z, work, dz):  # type: ignore[no-untyped-def]
    """Write dz (2, 4 + m), the derivative of z under all forces.

    The last two columns of dz[1] are the power of all forces, and the moment of the external ones
    about the world's origin. Those of z[1] are therefore the work and the angular impulse.
    """
    around, thrust, held, torque = forces
    m, mass = held.size, bodies.mass
    force = thrust * turned[0, 0]
    for k in range(m):
        torque[k] = held[k]
    r, v = complex(z[0, 0], z[0, 1]), complex(z[1, 0], z[1, 1])
    r_0, v_0 = r, v
    for k in range(m):
        r_0 -= scaled(1.0 / mass, turned[2, k])
        v_0 -= 1j * scaled(z[1, 2 + k] / mass, turned[2, k])
    force -= scaled(around[TETHER], v_0)
    torque[0] -= around[TWIST] * z[1, 2]
    if _is_near_edge(bodies, around, z):
        force += _border(bodies, around, turned, z, torque)
    write_rate(bodies, turned, force, torque, z, work, dz)
    tilt, film = complex(around[TILT_X], around[TILT_Y]), around[FILM]
    dz[1, 0] += tilt.real
    dz[1, 1] += tilt.imag
    power = dot(force, v_0) + mass * dot(tilt, v)
    moment = cross(r_0, force) + mass * cross(r, tilt)
    if film > 0.0 or around[PADS] > 0.0:
        twice_energy, turning = twice_energy_and_moment(bodies, turned, z)
        if around[PADS] > 0.0:
            film += around[PADS] / math.sqrt(twice_energy / mass + CREEP * CREEP)
        for i in range(2 + m):
            dz[1, i] -= film * z[1, i]
        power -= film * twice_energy
        moment -= film * turning
    for k in range(m):
        power += torque[k] * z[1, 2 + k]
        moment += torque[k]
    dz[0, 2 + m], dz[0, 3 + m], dz[1, 2 + m], dz[1, 3 + m] = 0.0, 0.0, power, moment


# For callers where inlining is not worth its compile time.
write_derivative_called = helper(write_derivative.py_func)
