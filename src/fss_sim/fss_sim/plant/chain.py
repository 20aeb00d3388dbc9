"""A chain of bodies in kernels: its arrays, a step of its motion, an impulse on it, its audit.

The state is that of centroidal.py (and gears.py): z (2, 4 + m), m = 1 + n, has the centre of mass c
and the headings psi of all bodies, then the rates of these, the work and the angular impulse of all
forces but those of contacts. An impulse has the components (c, psi) and changes the rates by

    c: J_c / M     psi: A^-1 J_psi     motor behind a flexible gear: -(change of psi before it) / N

so that a free rotor keeps its spin.

Functions of a whole chain are inlined: a call would count the references to its 40 arrays.
"""

from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.centroidal import (
    Bodies,
    from_centroidal,
    make_bodies,
    scaled,
    to_centroidal,
    twice_energy_and_moment,
    write_rate,
)
from fss_arm_model.integration import STEP, classical, controlled
from fss_arm_model.kernels import helper, inlined
from fss_arm_model.kinematics import cross
from fss_arm_model.layout import BASE_SIZE, LINK_SIZE
from fss_sim.plant.drives import apply_drives
from fss_sim.plant.gears import (
    GearParameters,
    Gears,
    apply_geared_drives,
    gear_twist,
    spring_torque,
    write_geared_derivative,
    write_geared_derivative_called,
)
from fss_sim.plant.surroundings import Forces, write_derivative, write_derivative_called

ROTOR, GEARS, AROUND, VALVES = 2, 10, 12, 40  # sizes of a chain's constants
FIXED_SIZE = BASE_SIZE + ROTOR + GEARS + AROUND + VALVES
JOINT_SIZE = LINK_SIZE + 1 + 7 + 4  # constants of a joint
FIXED_STATE, JOINT_STATE = 14, 9  # numbers of the state, without joints and of a joint

_classical, _controlled = classical(write_derivative), controlled(write_derivative_called)
_classical_geared = classical(write_geared_derivative)
_controlled_geared = controlled(write_geared_derivative_called)


class Chain(NamedTuple):
    """Arrays of one chain; those after `start` are scratch."""

    bodies: Bodies
    whole: Floats  # (m,) diagonal of A with all motors stuck
    rotor: Floats  # (2,) N^2 J, N J
    gear: GearParameters
    around: Floats  # (12,) Surroundings.vector()
    valves: Floats  # (8, 5)
    joints: Floats  # (n, 7)
    demand: Floats  # (n, 4)
    q: Floats  # (3 + n,)
    qd: Floats
    reference: Floats  # (n, 2)
    motors: Floats  # (n, 3)
    torques: Floats  # (n, 2)
    audit: Floats  # (2, 4)
    z: Floats
    vectors: Complexes  # (3, m) turned to z
    moving: Floats  # z, q, qd, reference and motors, of which these are views
    saved: Floats
    saved_vectors: Complexes
    start: Floats  # (2,) velocity of c at the start
    held: Floats
    torque: Floats
    requested: Floats
    inertia: Floats
    laws: Floats
    turned: Complexes
    work: Complexes
    k: Floats
    dz: Floats
    still: Floats
    turns: Floats
    drive: Floats
    sprung: Floats


@helper
def make_chain(constants, state, n):  # type: ignore[no-untyped-def]
    """Return the Chain of n joints that these numbers describe, see simulation.py."""
    m, kind, at = n + 1, np.complex128, BASE_SIZE + LINK_SIZE * n
    p, rotor = constants[:at].copy(), constants[at : at + 2].copy()
    shared = constants[at + 2 :]
    around, valves = shared[10:22].copy(), shared[22:62].copy().reshape((8, 5))
    rest, rows = shared[62 : 62 + n].copy(), shared[62 + n :]
    joints = rows[: 7 * n].copy().reshape((n, 7))
    demand = rows[7 * n : 11 * n].copy().reshape((n, 4))
    gear = GearParameters(
        shared[0],
        shared[1],
        shared[2],
        shared[3],
        shared[4],
        shared[5],
        shared[6],
        shared[7],
        shared[8],
        shared[9],
        rest,
    )
    size = 4 + m
    stiff = rotor.copy()
    if gear.stiffness > 0.0:
        size += n
        stiff[:] = 0.0
    bodies, vectors, after = make_bodies(p, stiff), np.empty((3, m), kind), state[6 + 7 * n :]
    moving, at = np.zeros(2 * size + 6 + 7 * n), 2 * size
    z, values = moving[:at].reshape((2, size)), moving[at:]
    values[:] = state[: 6 + 7 * n]
    q, qd, motion = values[: 3 + n], values[3 + n : 6 + 2 * n], values[6 + 2 * n :]
    chain = Chain(
        bodies,
        bodies.inertia[0].copy(),
        rotor,
        gear,
        around,
        valves,
        joints,
        demand,
        q,
        qd,
        motion[: 2 * n].reshape((n, 2)),
        motion[2 * n :].reshape((n, 3)),
        after[: 2 * n].copy().reshape((n, 2)),
        after[2 * n : 2 * n + 8].copy().reshape((2, 4)),
        z,
        vectors,
        moving,
        moving.copy(),
        vectors.copy(),
        np.empty(2),
        np.empty(m),
        np.empty(m),
        np.empty(m),
        np.empty((2, m)),
        np.empty((m, 6)),
        np.empty((3, m), kind),
        np.empty((2, m), kind),
        np.zeros((8, 2, size)),
        np.zeros((2, size)),
        np.zeros((2, size)),
        np.ones(n),
        np.zeros(n),
        np.empty(m),
    )
    to_centroidal(bodies, chain.q, chain.qd, vectors, z)
    if gear.stiffness > 0.0:
        for j in range(n):
            z[0, 4 + m + j], z[1, 4 + m + j] = chain.motors[j, 0], chain.motors[j, 1]
    chain.start[0], chain.start[1] = z[1, 0], z[1, 1]
    return chain


@helper
def _copy_state(moving, vectors, to, vectors_to):  # type: ignore[no-untyped-def]
    """Copy in loops, which are several times as fast as slices of small arrays."""
    for i in range(moving.size):
        to[i] = moving[i]
    for i in range(3):
        for k in range(vectors.shape[1]):
            vectors_to[i, k] = vectors[i, k]


@inlined
def save(chain):  # type: ignore[no-untyped-def]
    """Save the state, for `restore`."""
    _copy_state(chain.moving, chain.vectors, chain.saved, chain.saved_vectors)


@inlined
def restore(chain):  # type: ignore[no-untyped-def]
    """Restore the state that was saved."""
    _copy_state(chain.saved, chain.saved_vectors, chain.moving, chain.vectors)


@inlined
def step_chain(chain, step, tolerance):  # type: ignore[no-untyped-def]
    """Advance by one step; `step` counts from the first one of the valves' times."""
    bodies, z, held, thrust = chain.bodies, chain.z, chain.held, 0j
    held[:] = 0.0
    for i in range(chain.valves.shape[0]):
        if chain.valves[i, 3] <= step < chain.valves[i, 4]:
            thrust += complex(chain.valves[i, 0], chain.valves[i, 1])
            held[0] += chain.valves[i, 2]
    forces = Forces(chain.around, thrust, held, chain.torque)
    if chain.gear.stiffness > 0.0:
        geared = Gears(
            forces, chain.joints, chain.gear, chain.rotor, chain.turns, chain.drive, chain.sprung
        )
        apply_geared_drives(
            bodies,
            geared,
            chain.whole,
            chain.demand,
            chain.reference,
            chain.motors,
            z,
            chain.vectors,
            chain.work,
            chain.dz,
            chain.still,
        )
        if tolerance > 0.0:
            _controlled_geared(
                bodies, geared, STEP, tolerance, z, chain.vectors, chain.turned, chain.work, chain.k
            )
        else:
            _classical_geared(
                bodies, geared, STEP, z, chain.vectors, chain.turned, chain.work, chain.k
            )
    else:
        apply_drives(
            bodies,
            forces,
            chain.joints,
            chain.demand,
            chain.q,
            chain.qd,
            chain.reference,
            z,
            chain.vectors,
            chain.work,
            chain.dz,
            chain.inertia,
            chain.requested,
            chain.laws,
            chain.torques,
        )
        if tolerance > 0.0:
            _controlled(
                bodies, forces, STEP, tolerance, z, chain.vectors, chain.turned, chain.work, chain.k
            )
        else:
            _classical(bodies, forces, STEP, z, chain.vectors, chain.turned, chain.work, chain.k)
    from_centroidal(bodies, chain.vectors, z, chain.q, chain.qd)


@inlined
def _free_rotors(chain):  # type: ignore[no-untyped-def]
    """Exclude the rotors behind flexible gears from the inertia."""
    if chain.gear.stiffness > 0.0:
        for j in range(chain.turns.size):
            chain.bodies.inertia[0, j] = chain.whole[j] - chain.rotor[1] ** 2 / chain.rotor[0]
        chain.bodies.inertia[0, chain.turns.size] = chain.whole[chain.turns.size]


@inlined
def add_loads(chain, of, pivot, body, x, n, turn, rows, responses):  # type: ignore[no-untyped-def]
    """Add impulses on a body, at the point x, to `rows`, and their effects to `responses`.

    The impulses are along n, across it, and, in a third row, a `turn`. Both arrays contain the
    (c, psi) of this chain from index `of` on. The body's pivot is given.
    """
    bodies, load, m = chain.bodies, chain.torque, chain.held.size
    mass = bodies.mass
    _free_rotors(chain)
    for i in range(rows.shape[0]):
        force = n if i == 0 else 1j * n if i == 1 else 0j
        for j in range(m):
            lever = -scaled(1.0 / mass, chain.vectors[2, j])
            if j < body:
                lever = chain.vectors[1, j]
            elif j == body:
                lever += x - pivot
            load[j] = cross(lever, force)
        if i == 2:
            load[body] += turn
        write_rate(bodies, chain.vectors, 0j, load, chain.still, chain.work, chain.dz)
        rows[i, of] += force.real
        rows[i, of + 1] += force.imag
        responses[i, of] += force.real / mass
        responses[i, of + 1] += force.imag / mass
        for j in range(m):
            rows[i, of + 2 + j] += load[j]
            responses[i, of + 2 + j] += chain.dz[1, 2 + j]


@inlined
def add_rates(chain, change, of):  # type: ignore[no-untyped-def]
    """Add an instantaneous change, from index `of` on, to the rates of (c, psi)."""
    z, m = chain.z, chain.held.size
    for i in range(2 + m):
        z[1, i] += change[of + i]
    if chain.gear.stiffness > 0.0:
        for j in range(m - 1):
            z[1, 4 + m + j] -= chain.rotor[1] / chain.rotor[0] * change[of + 2 + j]
    from_centroidal(chain.bodies, chain.vectors, z, chain.q, chain.qd)


@helper
def finish_chain(chain, changes, state):  # type: ignore[no-untyped-def]
    """Write the state, with the audit, to `state` as make_chain reads it.

    changes: (2 + m or more,) what impulses between bodies have changed in the rates of (c, psi).
    """
    n, m, bodies, z, audit = chain.turns.size, chain.held.size, chain.bodies, chain.z, chain.audit
    _free_rotors(chain)
    twice_energy, moment = twice_energy_and_moment(bodies, chain.vectors, z)
    if chain.gear.stiffness > 0.0:
        gear, rotor = chain.gear, chain.rotor
        for j in range(n):
            _, x, xd = gear_twist(gear, z, j)
            wound = spring_torque(gear, x)
            spin = z[1, 4 + m + j] + rotor[1] / rotor[0] * z[1, 2 + j]
            twice_energy += rotor[0] * spin * spin + wound * wound / gear.stiffness
            moment += rotor[1] * spin
            chain.torques[j, 0], chain.torques[j, 1] = chain.motors[j, 2], wound + gear.damping * xd
            chain.motors[j, 0], chain.motors[j, 1] = z[0, 4 + m + j], z[1, 4 + m + j]
    for i in range(2):
        audit[0, i] = bodies.mass * z[1, i]
        audit[1, i] += bodies.mass * (z[1, i] - chain.start[i] - changes[i])
    audit[0, 2], audit[0, 3] = moment, 0.5 * twice_energy
    audit[1, 2] += z[1, 3 + m]
    audit[1, 3] += z[1, 2 + m]
    at = 3 + n
    state[:at], state[at : 2 * at] = chain.q, chain.qd
    at *= 2
    for j in range(n):
        for i in range(2):
            state[at + 2 * j + i] = chain.reference[j, i]
            state[at + 5 * n + 2 * j + i] = chain.torques[j, i]
        for i in range(3):
            state[at + 2 * n + 3 * j + i] = chain.motors[j, i]
    for i in range(4):
        state[at + 7 * n + i], state[at + 7 * n + 4 + i] = audit[0, i], audit[1, i]
