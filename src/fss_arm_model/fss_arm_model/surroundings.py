"""What acts on the floating arm from outside its joints: table, air film, tether and thrusters.

In-kernel functions take them as numbers (SURROUNDINGS,), or as an empty array: nothing there.

    0, 1  acceleration of all that floats, x and y, as the table is tilted [m/s^2]
    2     air film: its shear grows with the mass it carries, so each mass element m feels
          -film m v [1/s]
    3, 4  tether: on the base's origin -tether v [N s/m], on its turning -twist omega [N m s]
    5, 6  the table's edges: half its size, x and y [m]
    7, 8  of its border: stiffness [N/m], damping [N s/m]
    9, 10 radius of the base about its origin, and of joints and tip [m]
"""

import math

from ._cache import helper, inlined
from .centroidal import _momenta, _rate, _scaled
from .kinematics import _cross, _dot

SURROUNDINGS = 11


@helper
def _push(surroundings, r, v, radius):  # type: ignore[no-untyped-def]
    """The border's force on a disc at r that moves at v; it pushes and never pulls."""
    stiffness, damping = surroundings[7], surroundings[8]
    x = y = 0.0
    deep = abs(r.real) + radius - surroundings[5]
    if deep > 0.0:
        out = math.copysign(1.0, r.real)
        x = -out * max(0.0, stiffness * deep + damping * out * v.real)
    deep = abs(r.imag) + radius - surroundings[6]
    if deep > 0.0:
        out = math.copysign(1.0, r.imag)
        y = -out * max(0.0, stiffness * deep + damping * out * v.imag)
    return complex(x, y)


@helper
def _is_near_edge(bodies, surroundings, z):  # type: ignore[no-untyped-def]
    """Whether any part may touch the border, judged by the largest reach there can be."""
    reach = max(surroundings[9], surroundings[10])
    for k in range(bodies.arms.shape[1]):
        reach += max(abs(bodies.arms[0, k]), abs(bodies.arms[1, k]) / bodies.mass)
    far_x, far_y = abs(z[0, 0]) + reach > surroundings[5], abs(z[0, 1]) + reach > surroundings[6]
    return far_x or far_y


@helper
def _border(bodies, surroundings, turned, z, torque):  # type: ignore[no-untyped-def]
    """Add the border's forces on base, joints and tip to the torques; return their sum.

    A force at a pivot is as one on the base's origin and torques d_k x f on the bodies before.
    """
    m, mass = torque.size, bodies.mass
    r, v = complex(z[0, 0], z[0, 1]), complex(z[1, 0], z[1, 1])
    for k in range(m):
        r -= _scaled(1.0 / mass, turned[2, k])
        v -= 1j * _scaled(z[1, 2 + k] / mass, turned[2, k])
    force = _push(surroundings, r, v, surroundings[9])
    for k in range(m):
        d = turned[1, k] + _scaled(1.0 / mass, turned[2, k])
        r += d
        v += 1j * _scaled(z[1, 2 + k], d)
        if m > 1:
            push = _push(surroundings, r, v, surroundings[10])
            force += push
            for j in range(k + 1):
                back = turned[1, j] + _scaled(1.0 / mass, turned[2, j])
                torque[j] += _cross(back, push)
    return force


@inlined
def _act(bodies, surroundings, force, thrust, held, turned, z, work, torque, dz):  # type: ignore[no-untyped-def]
    """Write dz (2, 2 + m) under all that acts; scratch work and torque (m,).

    `force` and `thrust` are on the base's origin, in world axes and in the base's own; `held` (m,)
    are torques on the bodies. Where there are surroundings, all are (2, 4 + m): the last
    columns of dz[1] are the power of all forces and the moment, about the world's origin, of those
    from outside, so that z[1] has the work and the angular impulse there.
    """
    m, mass = held.size, bodies.mass
    force += thrust * turned[0, 0]
    for k in range(m):
        torque[k] = held[k]
    r, v = complex(z[0, 0], z[0, 1]), complex(z[1, 0], z[1, 1])
    r_0, v_0 = r, v
    if surroundings.size > 0:
        for k in range(m):
            r_0 -= _scaled(1.0 / mass, turned[2, k])
            v_0 -= 1j * _scaled(z[1, 2 + k] / mass, turned[2, k])
        force -= _scaled(surroundings[3], v_0)
        torque[0] -= surroundings[4] * z[1, 2]
        if _is_near_edge(bodies, surroundings, z):
            force += _border(bodies, surroundings, turned, z, torque)
    _rate(bodies, turned, force, torque, z, work, dz)
    if surroundings.size > 0:
        tilt, film = complex(surroundings[0], surroundings[1]), surroundings[2]
        dz[1, 0] += tilt.real
        dz[1, 1] += tilt.imag
        for i in range(2 + m):
            dz[1, i] -= film * z[1, i]
        twice_energy, moment = _momenta(bodies, turned, z)
        power = _dot(force, v_0) + mass * _dot(tilt, v) - film * twice_energy
        moment = _cross(r_0, force) + mass * _cross(r, tilt) - film * moment
        for k in range(m):
            power += torque[k] * z[1, 2 + k]
            moment += torque[k]
        dz[0, 2 + m], dz[0, 3 + m], dz[1, 2 + m], dz[1, 3 + m] = 0.0, 0.0, power, moment


_act_called = helper(_act.py_func)  # where inlining it would cost more to compile than it gains
