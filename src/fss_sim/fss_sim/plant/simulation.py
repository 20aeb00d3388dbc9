"""Simulation of the plant: many steps of arm, drives, thrusters and surroundings in one kernel.

Each call also audits momentum and energy. It computes the momentum and the energy of the bodies,
and integrates the impulse and the work of every force on them. The two must change by the same
amount.
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.centroidal import (
    from_centroidal,
    make_bodies,
    to_centroidal,
    twice_energy_and_moment,
)
from fss_arm_model.integration import STEP, classical, controlled
from fss_arm_model.kernels import helper, kernel
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

_classical, _controlled = classical(write_derivative), controlled(write_derivative_called)
_classical_geared = classical(write_geared_derivative)
_controlled_geared = controlled(write_geared_derivative_called)


@helper
def _thrust(valves, step, held):  # type: ignore[no-untyped-def]
    """Return the force of the open valves in a step, as a complex number.

    Their torque is added to held[0].
    """
    thrust = 0j
    for valve in valves:
        if valve[3] <= step < valve[4]:
            thrust += complex(valve[0], valve[1])
            held[0] += valve[2]
    return thrust


@helper
def _write_audit(  # type: ignore[no-untyped-def]
    bodies, z, m, start_x, start_y, moment, twice_energy, audit0, audit
):
    """Write to `audit` the bodies' momentum and energy, and the total impulse and work on them."""
    audit[0, 0], audit[0, 1] = bodies.mass * z[1, 0], bodies.mass * z[1, 1]
    audit[0, 2], audit[0, 3] = moment, 0.5 * twice_energy
    audit[1, 0] = audit0[1, 0] + bodies.mass * (z[1, 0] - start_x)
    audit[1, 1] = audit0[1, 1] + bodies.mass * (z[1, 1] - start_y)
    audit[1, 2], audit[1, 3] = audit0[1, 2] + z[1, 3 + m], audit0[1, 3] + z[1, 2 + m]


@kernel("(p),(r),(n,l),(e),(t,f),(n,d),(c),(s,m),(n,g),(b,a)->(s,m),(n,g),(b,a),(n,s)")
def _advance(  # type: ignore[no-untyped-def]
    p,
    rotor,
    joints,
    surroundings,
    valves,
    demand,
    control,
    state0,
    reference0,
    audit0,
    state,
    reference,
    audit,
    torques,
):
    m, kind = state.shape[1] - 2, np.complex128
    bodies = make_bodies(p.copy(), rotor.copy())
    z, k = np.zeros((2, 4 + m)), np.zeros((8, 2, 4 + m))
    start_vectors, turned = np.empty((3, m), kind), np.empty((3, m), kind)
    work = np.empty((2, m), kind)
    held, torque, requested, inertia = np.empty(m), np.empty(m), np.empty(m), np.empty((2, m))
    laws, dz, around = np.empty((m, 6)), np.zeros((2, 4 + m)), surroundings.copy()
    joint_rows, demands, references = joints.copy(), demand.copy(), reference0.copy()
    joint_torques = np.zeros((m, 2))
    q, qd = state0[0].copy(), state0[1].copy()
    to_centroidal(bodies, q, qd, start_vectors, z)
    start_x, start_y = z[1, 0], z[1, 1]
    steps, tolerance = int(control[0]), control[1]
    for step in range(steps):
        held[:] = 0.0
        thrust = _thrust(valves, step, held)
        forces = Forces(around, thrust, held, torque)
        apply_drives(
            bodies,
            forces,
            joint_rows,
            demands,
            q,
            qd,
            references,
            z,
            start_vectors,
            work,
            dz,
            inertia,
            requested,
            laws,
            joint_torques,
        )
        if tolerance > 0.0:
            _controlled(bodies, forces, STEP, tolerance, z, start_vectors, turned, work, k)
        else:
            _classical(bodies, forces, STEP, z, start_vectors, turned, work, k)
        from_centroidal(bodies, start_vectors, z, q, qd)
    for i in range(2 + m):
        state[0, i], state[1, i] = q[i], qd[i]
    for j in range(m - 1):
        reference[j, 0], reference[j, 1] = references[j, 0], references[j, 1]
        torques[j, 0], torques[j, 1] = joint_torques[j, 0], joint_torques[j, 1]
    twice_energy, moment = twice_energy_and_moment(bodies, start_vectors, z)
    _write_audit(bodies, z, m, start_x, start_y, moment, twice_energy, audit0, audit)


@kernel(
    "(p),(r),(n,l),(f),(n),(e),(t,v),(n,d),(c),(s,m),(n,g),(n,h),(b,a)->(s,m),(n,g),(n,h),(b,a),(n,s)"
)
def _advance_geared(  # type: ignore[no-untyped-def]
    p,
    rotor,
    joints,
    shared,
    rest,
    surroundings,
    valves,
    demand,
    control,
    state0,
    reference0,
    motors0,
    audit0,
    state,
    reference,
    motors,
    audit,
    torques,
):
    n, kind = demand.shape[0], np.complex128
    m, size = n + 1, 5 + 2 * n
    bodies, z, k = make_bodies(p.copy(), np.zeros(2)), np.zeros((2, size)), np.zeros((8, 2, size))
    start_vectors, turned = np.empty((3, m), kind), np.empty((3, m), kind)
    work = np.empty((2, m), kind)
    dz, still, whole = np.zeros((2, size)), np.zeros((2, size)), bodies.inertia[0].copy()
    held, torque, turns, drive = np.empty(m), np.empty(m), np.ones(n), np.zeros(n)
    around, turning, sprung = surroundings.copy(), rotor.copy(), np.empty(m)
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
        rest.copy(),
    )
    joint_rows, demands, references = joints.copy(), demand.copy(), reference0.copy()
    motor_states = motors0.copy()
    q, qd = state0[0].copy(), state0[1].copy()
    to_centroidal(bodies, q, qd, start_vectors, z)
    for j in range(n):
        z[0, 4 + m + j], z[1, 4 + m + j] = motor_states[j, 0], motor_states[j, 1]
    start_x, start_y = z[1, 0], z[1, 1]
    steps, tolerance = int(control[0]), control[1]
    for step in range(steps):
        held[:] = 0.0
        thrust = _thrust(valves, step, held)
        forces = Forces(around, thrust, held, torque)
        geared = Gears(forces, joint_rows, gear, turning, turns, drive, sprung)
        apply_geared_drives(
            bodies,
            geared,
            whole,
            demands,
            references,
            motor_states,
            z,
            start_vectors,
            work,
            dz,
            still,
        )
        if tolerance > 0.0:
            _controlled_geared(bodies, geared, STEP, tolerance, z, start_vectors, turned, work, k)
        else:
            _classical_geared(bodies, geared, STEP, z, start_vectors, turned, work, k)
    from_centroidal(bodies, start_vectors, z, q, qd)
    for i in range(2 + m):
        state[0, i], state[1, i] = q[i], qd[i]
    ratio = turning[1] / turning[0]
    for i in range(n):
        bodies.inertia[0, i] = whole[i] - ratio * turning[1]
    bodies.inertia[0, n] = whole[n]
    twice_energy, moment = twice_energy_and_moment(bodies, start_vectors, z)
    for j in range(n):
        _, x, xd = gear_twist(gear, z, j)
        wound, spin = spring_torque(gear, x), z[1, 4 + m + j] + ratio * z[1, 2 + j]
        twice_energy += turning[0] * spin * spin + wound * wound / gear.stiffness
        moment += turning[1] * spin
        torques[j, 0], torques[j, 1] = motor_states[j, 2], wound + gear.damping * xd
        motors[j, 0], motors[j, 1] = z[0, 4 + m + j], z[1, 4 + m + j]
        motors[j, 2] = motor_states[j, 2]
        reference[j, 0], reference[j, 1] = references[j, 0], references[j, 1]
    _write_audit(bodies, z, m, start_x, start_y, moment, twice_energy, audit0, audit)


def advance(
    p: npt.ArrayLike,
    rotor: npt.ArrayLike,
    joints: npt.ArrayLike,
    surroundings: npt.ArrayLike,
    valves: npt.ArrayLike,
    demand: npt.ArrayLike,
    state: npt.ArrayLike,
    reference: npt.ArrayLike,
    audit: npt.ArrayLike,
    steps: int,
    tolerance: float = 0.0,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Advance the plant by `steps` steps of STEP. n may be 0: a base without an arm.

    Args:
        p: (8 + 6 n,) Arm.vector().
        rotor: (2,) N^2 J and N J [kg m^2]: each joint's rotor has inertia J and turns N times as
            fast as the joint.
        joints: (n, 7) minimum and maximum angle [rad], maximum torque of the motor [N m]; viscous
            [N m s/rad] and Coulomb friction [N m]; stiffness [N m/rad] and damping [N m s/rad] of
            the end stops.
        surroundings: (12,) Surroundings.vector().
        valves: (t, 5) force on the base's origin in the base frame [N] and torque [N m] of a
            thruster while its valve is open; the first step in which it is open; the step in which
            it is closed again.
        demand: (n, 4) for each drive: mode, set point [N m, rad/s or rad, by mode], speed [rad/s]
            and acceleration [rad/s^2] of the profile. The acceleration is above 0 except in mode
            off. Position mode at speed 0 means: decelerate, then hold the angle reached.
        state: (2, 3 + n) q and qd.
        reference: (n, 2) reference angle [rad] and rate [rad/s] of each drive.
        audit: (2, 4) audit of the previous call; its first row is not used.
        steps: number of steps.
        tolerance: largest error of a step in any coordinate or rate, in SI units, for the
            Dormand-Prince method with error control; 0: classical Runge-Kutta method.

    Returns:
        state and reference after the steps.
        audit (2, 4): linear momentum [N s], angular momentum about the world's origin [N m s] and
        energy [J]. The first row is that of the bodies. The second row is the amount supplied by
        forces, added to the second row of the argument.
        torques (n, 2) [N m] of the last step: of each motor, and transmitted by each gear, which is
        the former minus friction; 0 if there was no step.
        Leading dimensions broadcast.
    """
    control = np.array([steps, tolerance], dtype=float)
    return _advance(
        p, rotor, joints, surroundings, valves, demand, control, state, reference, audit
    )


def advance_geared(
    p: npt.ArrayLike,
    rotor: npt.ArrayLike,
    joints: npt.ArrayLike,
    gears: GearParameters,
    surroundings: npt.ArrayLike,
    valves: npt.ArrayLike,
    demand: npt.ArrayLike,
    state: npt.ArrayLike,
    reference: npt.ArrayLike,
    motors: npt.ArrayLike,
    audit: npt.ArrayLike,
    steps: int,
    tolerance: float = 0.0,
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Advance a plant with flexible joints (gears.py); the rotors' inertia must be above 0.

    Arguments and results are those of `advance`, with these additions: gears, from
    Joints.gears(); motors (n, 3), the angle [rad] and rate [rad/s] of each motor, seen behind its
    gear, and its torque [N m]. The audit's energy includes that of the springs. The torques are
    those at the end, of the motors and transmitted by the gears, even if there was no step.
    """
    control = np.array([steps, tolerance], dtype=float)
    *shared, rest = gears
    return _advance_geared(
        p,
        rotor,
        joints,
        shared,
        rest,
        surroundings,
        valves,
        demand,
        control,
        state,
        reference,
        motors,
        audit,
    )
