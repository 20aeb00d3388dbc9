"""Flexible joints: each motor turns separately, behind a gear that is a spring.

In addition to the bodies of centroidal.py, z has the angle theta and the rate of each joint's
motor, seen behind the gear of ratio N (Spong 1987, here with the rotor's full kinetic energy):

    T = sum J (psi'_{k-1} + N theta'_k)^2 / 2 + ...     V = sum K band(theta_k - q_k)^2 / 2
    N^2 J (theta'' + psi''_{k-1} / N) = u - s           s = K band(theta - q) + D (theta' - q')

The gear's torque s acts on the link, and -s - (u - s) / N acts on the body before it. The moment of
inertia of that body then excludes J, so that A contains no rotor. band(x) is x minus a dead band. s
is evaluated at each stage of the integration. u is the drive's torque minus friction; it is
constant during a step.

Friction acts on the motor's side. It has a viscous part, and a part F given by Stribeck's curve:

    F(v) = coulomb + max(0, static - coulomb) exp(-(v / stribeck)^2)

A motor sticks in a step if F can hold it. Its rate is then exactly 0. The rate v^+ at the end of
a step is found implicitly, with friction and servo (drives.py) evaluated there, from

    N^2 J (v^+ - v) / dt = tau(v^+) - viscous v^+ - F(v) sign(v^+) + ripple(theta) - s
"""

import math
from typing import NamedTuple

from fss_arm_model.arrays import Floats
from fss_arm_model.centroidal import write_rate
from fss_arm_model.integration import STEP
from fss_arm_model.kernels import helper, inlined
from fss_sim.plant.drives import (
    DAMPING,
    MODE_CURRENT,
    MODE_OFF,
    STIFFNESS,
    advance_profile,
    profile_goal,
)
from fss_sim.plant.surroundings import Forces, write_derivative


class GearParameters(NamedTuple):
    """Parameters of the gears and motors, the same for all joints except the angle at rest."""

    stiffness: float  # of the spring [N m/rad]
    damping: float  # [N m s/rad]
    half_band: float  # half the dead band [rad]
    static: float  # static friction [N m]
    stribeck_speed: float  # [rad/s]
    ripple: float  # amplitude of the torque ripple [N m]
    ripple_order: float  # periods of the ripple per turn of the joint
    mean_response: float  # share of a new command in the motor's mean torque of a step
    decay: float  # share of the previous torque that is left at the end of a step
    cancelled: float  # share of the friction that a servo compensates
    rest: Floats  # (n,) true angle of each joint at an encoder reading of 0 [rad]


class Gears(NamedTuple):
    """Forces on bodies and motors in a step, with the parameters of the gears."""

    forces: Forces
    joints: Floats  # (n, 7) as in advance
    parameters: GearParameters
    rotor: Floats  # (2,) N^2 J, N J
    turns: Floats  # (n,) 1 for a motor that turns, 0 for one that sticks
    drive: Floats  # (n,) u
    sprung: Floats  # (m,) scratch


@helper
def spring_torque(gear, x):  # type: ignore[no-untyped-def]
    """Return the torque of a gear's spring twisted by x; gear: GearParameters."""
    return gear.stiffness * (max(x - gear.half_band, 0.0) + min(x + gear.half_band, 0.0))


@helper
def gear_twist(gear, z, j):  # type: ignore[no-untyped-def]
    """Return the rate of joint j, and the angle and rate of its motor relative to the joint."""
    motor = 3 + z.shape[1] // 2 + j
    q, qd = z[0, 3 + j] - z[0, 2 + j] - gear.rest[j], z[1, 3 + j] - z[1, 2 + j]
    return qd, z[0, motor] - q, z[1, motor] - qd


@inlined
def write_geared_derivative(bodies, geared, turned, z, work, dz):  # type: ignore[no-untyped-def]
    """Write dz (2, 4 + m + n) under all forces, including the gears' springs."""
    forces, joints, gear, rotor, turns, drive, sprung = geared
    n, m = drive.size, sprung.size
    ratio, power, spun = rotor[1] / rotor[0], 0.0, 0.0
    for k in range(m):
        sprung[k] = forces.held[k]
    for j in range(n):
        q, qd = z[0, 3 + j] - z[0, 2 + j] - gear.rest[j], z[1, 3 + j] - z[1, 2 + j]
        x, xd = z[0, 4 + m + j] - q, z[1, 4 + m + j] - qd
        wound = gear.stiffness * (max(x - gear.half_band, 0.0) + min(x + gear.half_band, 0.0))
        applied = wound + gear.damping * xd
        left = turns[j] * (drive[j] - applied)  # of the drive's torque, for its rotor
        power += wound * xd + left * (z[1, 4 + m + j] + ratio * z[1, 2 + j])
        spun += ratio * left
        over = max(q - joints[j, 1], 0.0) + min(q - joints[j, 0], 0.0)
        push = -joints[j, 5] * over - joints[j, 6] * qd  # of the end stop
        if push * over < 0.0:
            applied += push
        sprung[j] -= applied + ratio * left
        sprung[j + 1] += applied
        dz[1, 4 + m + j] = left / rotor[0]
    sum_of_all = Forces(forces.around, forces.thrust, sprung, forces.torque)
    write_derivative(bodies, sum_of_all, turned, z, work, dz)
    for j in range(n):
        dz[0, 4 + m + j] = z[1, 4 + m + j]
        dz[1, 4 + m + j] -= turns[j] * ratio * dz[1, 2 + j]
    dz[1, 2 + m] += power
    dz[1, 3 + m] += spun


write_geared_derivative_called = helper(write_geared_derivative.py_func)


@helper
def _stribeck(joint, gear, v):  # type: ignore[no-untyped-def]
    """Return F(v), the part of the friction that is not viscous."""
    more = max(gear.static - joint[4], 0.0)
    return joint[4] + more * math.exp(-((v / gear.stribeck_speed) ** 2))


@helper
def _after_friction(push, friction):  # type: ignore[no-untyped-def]
    """Return the remainder of a push after friction; 0 if the friction is larger."""
    return max(push - friction, 0.0) + min(push + friction, 0.0)


@helper
def _advance_motor(joint, gear, demand, inertia, x, v, s, carried, motor, reference):  # type: ignore[no-untyped-def]
    """Advance the reference (2,) and the motor's torque, motor[2], by one step.

    x and v are the motor's angle and rate, s is the gear's torque, carried is the joint's rate.

    Returns:
        u, and whether the motor sticks.
    """
    mode, set_point, speed, acceleration = demand
    most, viscous, coulomb = joint[2], joint[3], joint[4]
    mean, left = gear.mean_response, gear.decay
    r, rate, servo_damping, command_torque, compensation = x, v, 0.0, 0.0, 0.0
    if mode == MODE_CURRENT:
        command_torque = min(max(set_point, -most), most)
    elif mode == MODE_OFF:
        mean, left = 1.0, 0.0
    else:
        goal = profile_goal(mode, set_point, joint[0], joint[1], reference[0])
        r, rate = advance_profile(goal, speed, acceleration, reference[0], reference[1])
        servo_damping = DAMPING
        if rate != 0.0:
            compensation = gear.cancelled * (viscous * rate + math.copysign(coulomb, rate))
        command_torque = compensation - STIFFNESS * (x + STEP * v - r) + DAMPING * rate
    reference[0], reference[1] = r, rate
    friction = _stribeck(joint, gear, v)
    other = inertia * v / STEP + (1.0 - mean) * motor[2] - s
    if gear.ripple > 0.0:
        other += gear.ripple * math.sin(gear.ripple_order * x)
    slope = inertia / STEP + viscous
    pushed = _after_friction(other + mean * command_torque, friction)
    after = pushed / (slope + mean * servo_damping)
    requested = command_torque - servo_damping * after
    applied = min(max(requested, -most), most)
    if applied != requested:
        # The torque is saturated: the reference continues from the motor's position.
        pushed = _after_friction(other + mean * applied, friction)
        after = pushed / slope
        reference[0], reference[1] = x + STEP * v + (applied - compensation) / STIFFNESS, carried
    net = (after - v) * inertia / STEP + s
    motor[2] = left * motor[2] + (1.0 - left) * applied
    return net, pushed == 0.0 and friction > 0.0


@helper
def apply_geared_drives(  # type: ignore[no-untyped-def]
    bodies, geared, whole, demand, reference, motors, z, start_vectors, work, dz, still
):
    """Set the drives' torques for the next step, and stop the motors that stick in it.

    A motor is stopped by an impulse between rotor and stator. Its work enters the energy audit.
    whole (m,) is the diagonal of A with all motors stuck. The last column of motors (n, 3) is their
    torque. dz and still (2, 4 + m + n) are scratch; still is 0.
    """
    rotor, torque, gear = geared.rotor, geared.forces.torque, geared.parameters
    n, m = motors.shape[0], torque.size
    ratio, stops = rotor[1] / rotor[0], False
    for k in range(m):
        torque[k], bodies.inertia[0, k] = 0.0, whole[k]
    for j in range(n):
        qd, x, xd = gear_twist(gear, z, j)
        s = spring_torque(gear, x) + gear.damping * xd
        theta, rate = z[0, 4 + m + j], z[1, 4 + m + j]
        geared.drive[j], sticks = _advance_motor(
            geared.joints[j], gear, demand[j], rotor[0], theta, rate, s, qd, motors[j], reference[j]
        )
        geared.turns[j] = 0.0 if sticks else 1.0
        bodies.inertia[0, j] -= geared.turns[j] * ratio * rotor[1]
        if sticks and rate != 0.0:
            torque[j] += rotor[1] * rate
            stops = True
    if stops:
        write_rate(bodies, start_vectors, 0j, torque, still, work, dz)
        for k in range(m):
            z[1, 2 + k] += dz[1, 2 + k]
        for j in range(n):
            rate = z[1, 4 + m + j]
            gained = -rate if geared.turns[j] == 0.0 else -ratio * dz[1, 2 + j]
            impulse = rotor[0] * gained + rotor[1] * dz[1, 2 + j]
            z[1, 4 + m + j] += gained
            z[1, 2 + m] += impulse * (rate + 0.5 * gained)
