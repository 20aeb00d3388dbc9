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

from fss_arm_model.centroidal import _rate
from fss_arm_model.integration import STEP
from fss_arm_model.kernels import Floats, helper, inlined
from fss_sim.plant.drives import DAMPING, MODE_CURRENT, MODE_OFF, STIFFNESS, _goal, _profile
from fss_sim.plant.surroundings import Forces, _derivative

# Columns of the gear parameters.
SPRING, DAMPER, BAND, STATIC, STRIBECK, RIPPLE, PERIODS, MEAN, DECAY, CANCELLED, REST = range(11)


class Gears(NamedTuple):
    """Forces on bodies and motors in a step, with the parameters of the gears."""

    forces: Forces
    joints: Floats  # (n, 7) as in advance
    gears: Floats  # (n, 11)
    rotor: Floats  # (2,) N^2 J, N J
    turns: Floats  # (n,) 1 for a motor that turns, 0 for one that sticks
    drive: Floats  # (n,) u
    sprung: Floats  # (m,) scratch


@helper
def _spring_torque(gear, x):  # type: ignore[no-untyped-def]
    """Return the torque of a gear's spring twisted by x."""
    return gear[SPRING] * (max(x - gear[BAND], 0.0) + min(x + gear[BAND], 0.0))


@helper
def _twist(gear, z, j):  # type: ignore[no-untyped-def]
    """Return the rate of joint j, and the angle and rate of its motor relative to the joint."""
    motor = 3 + z.shape[1] // 2 + j
    q, qd = z[0, 3 + j] - z[0, 2 + j] - gear[REST], z[1, 3 + j] - z[1, 2 + j]
    return qd, z[0, motor] - q, z[1, motor] - qd


@inlined
def _geared_derivative(bodies, geared, turned, z, work, dz):  # type: ignore[no-untyped-def]
    """Write dz (2, 4 + m + n) under all forces, including the gears' springs."""
    forces, joints, gears, rotor, turns, drive, sprung = geared
    n, m = drive.size, sprung.size
    ratio, power, spun = rotor[1] / rotor[0], 0.0, 0.0
    for k in range(m):
        sprung[k] = forces.held[k]
    for j in range(n):
        q, qd = z[0, 3 + j] - z[0, 2 + j] - gears[j, REST], z[1, 3 + j] - z[1, 2 + j]
        x, xd = z[0, 4 + m + j] - q, z[1, 4 + m + j] - qd
        wound = gears[j, SPRING] * (max(x - gears[j, BAND], 0.0) + min(x + gears[j, BAND], 0.0))
        applied = wound + gears[j, DAMPER] * xd
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
    _derivative(bodies, sum_of_all, turned, z, work, dz)
    for j in range(n):
        dz[0, 4 + m + j] = z[1, 4 + m + j]
        dz[1, 4 + m + j] -= turns[j] * ratio * dz[1, 2 + j]
    dz[1, 2 + m] += power
    dz[1, 3 + m] += spun


_geared_derivative_called = helper(_geared_derivative.py_func)


@helper
def _stribeck(joint, gear, v):  # type: ignore[no-untyped-def]
    """Return F(v), the part of the friction that is not viscous."""
    more = max(gear[STATIC] - joint[4], 0.0)
    return joint[4] + more * math.exp(-((v / gear[STRIBECK]) ** 2))


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
    mean, left = gear[MEAN], gear[DECAY]
    r, rate, servo_damping, command_torque, compensation = x, v, 0.0, 0.0, 0.0
    if mode == MODE_CURRENT:
        command_torque = min(max(set_point, -most), most)
    elif mode == MODE_OFF:
        mean, left = 1.0, 0.0
    else:
        goal = _goal(mode, set_point, joint[0], joint[1], reference[0])
        r, rate = _profile(goal, speed, acceleration, reference[0], reference[1])
        servo_damping = DAMPING
        if rate != 0.0:
            compensation = gear[CANCELLED] * (viscous * rate + math.copysign(coulomb, rate))
        command_torque = compensation - STIFFNESS * (x + STEP * v - r) + DAMPING * rate
    reference[0], reference[1] = r, rate
    friction = _stribeck(joint, gear, v)
    other = inertia * v / STEP + (1.0 - mean) * motor[2] - s
    if gear[RIPPLE] > 0.0:
        other += gear[RIPPLE] * math.sin(gear[PERIODS] * x)
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
def _apply_geared_drives(  # type: ignore[no-untyped-def]
    bodies, geared, whole, demand, reference, motors, z, start_vectors, work, dz, still
):  # fmt: skip
    """Set the drives' torques for the next step, and stop the motors that stick in it.

    A motor is stopped by an impulse between rotor and stator. Its work enters the energy audit.
    whole (m,) is the diagonal of A with all motors stuck. The last column of motors (n, 3) is their
    torque. dz and still (2, 4 + m + n) are scratch; still is 0.
    """
    rotor, torque = geared.rotor, geared.forces.torque
    n, m = motors.shape[0], torque.size
    ratio, stops = rotor[1] / rotor[0], False
    for k in range(m):
        torque[k], bodies.inertia[0, k] = 0.0, whole[k]
    for j in range(n):
        qd, x, xd = _twist(geared.gears[j], z, j)
        s = _spring_torque(geared.gears[j], x) + geared.gears[j, DAMPER] * xd
        theta, rate = z[0, 4 + m + j], z[1, 4 + m + j]
        geared.drive[j], sticks = _advance_motor(
            geared.joints[j], geared.gears[j], demand[j], rotor[0], theta, rate, s, qd,
            motors[j], reference[j],
        )  # fmt: skip
        geared.turns[j] = 0.0 if sticks else 1.0
        bodies.inertia[0, j] -= geared.turns[j] * ratio * rotor[1]
        if sticks and rate != 0.0:
            torque[j] += rotor[1] * rate
            stops = True
    if stops:
        _rate(bodies, start_vectors, 0j, torque, still, work, dz)
        for k in range(m):
            z[1, 2 + k] += dz[1, 2 + k]
        for j in range(n):
            rate = z[1, 4 + m + j]
            gained = -rate if geared.turns[j] == 0.0 else -ratio * dz[1, 2 + j]
            impulse = rotor[0] * gained + rotor[1] * dz[1, 2 + j]
            z[1, 4 + m + j] += gained
            z[1, 2 + m] += impulse * (rate + 0.5 * gained)
