"""Model of each joint's servo drive, of the friction in its harmonic drive, and of its end stops.

A drive reads its encoder at the start of a period and holds its torque during that period.

    off       no torque
    current   the commanded torque
    velocity  a ramp to the velocity, which stops at the soft limit of the joint's range
    position  a trapezoidal profile to the angle, or to the soft limit if that comes first

Velocity and position mode share one generator of a reference (r, v). A PD servo follows it. The
servo also compensates the friction, as the integral action of a real drive does:

    tau = -stiffness (q + dt qd - r) - damping (qd + dt qdd - v)

q and qd are predicted one step ahead (Tan, Liu & Turk 2011, stable PD control). This is stable for
all gains and inertias, as is the much faster current loop of a real drive. Friction and end stops
are predicted in the same way:

    friction  -(viscous + coulomb / sqrt(qd^2 + smooth^2)) qd
    stop      beyond the joint's range, a spring and a damper that push and never pull

Without a servo the root is that of the step's start, for stability. A servo compensates the
friction of the predicted rate.
"""

import math

from fss_arm_model.centroidal import Bodies
from fss_arm_model.integration import STEP
from fss_arm_model.kernels import helper
from fss_sim.plant.surroundings import Forces, write_derivative_called

#: Modes of a drive, with the numbers of docs/reference/protocol.md.
MODE_OFF, MODE_CURRENT, MODE_VELOCITY, MODE_POSITION = 0.0, 1.0, 11.0, 21.0

# With four links the generalized inertia of a joint is 0.01 to 2 kg m^2, depending on the posture.
# For such loads all motion decays by exp(-20 t) or faster, and 1.8 N m turn the joint by 0.75 mrad.
STIFFNESS, DAMPING = 2400.0, 80.0  # [N m/rad], [N m s/rad]
SMOOTHING_SPEED = 0.005  # of the Coulomb friction [rad/s]


@helper
def profile_goal(mode, set_point, lowest, highest, r):  # type: ignore[no-untyped-def]
    """Return the angle to which a reference at r moves."""
    if mode == MODE_POSITION:
        return min(max(set_point, lowest), highest)
    return max(highest, r) if set_point > 0.0 else min(lowest, r)


@helper
def advance_profile(goal, speed, acceleration, r, v):  # type: ignore[no-untyped-def]
    """Return the reference (r, v) one step later, moved to the goal within speed and acceleration.

    To stop from the speed k dv, with dv = acceleration dt, in whole steps takes the distance
    k (k + 1) / 2 dv dt. The k that the remaining distance allows limits the speed, so that the
    reference lands on the goal.
    """
    dv = acceleration * STEP
    distance = abs(goal - r)
    k = 0.5 * (math.sqrt(1.0 + 8.0 * distance / (dv * STEP)) - 1.0)
    target_speed = math.copysign(min(speed, k * dv, distance / STEP), goal - r)
    v += min(max(target_speed - v, -dv), dv)
    return r + v * STEP, v


@helper
def _end_stop(joint, q, qd):  # type: ignore[no-untyped-def]
    """Return the torque of the end stop, and its decrease at an acceleration of 1/STEP."""
    lowest, highest, stiffness, damping = joint[0], joint[1], joint[5], joint[6]
    ahead = q + STEP * qd
    over = max(ahead - highest, 0.0) + min(ahead - lowest, 0.0)
    push = -stiffness * over - damping * qd
    if push * over < 0.0:
        return push, damping + STEP * stiffness
    return 0.0, 0.0


@helper
def _friction_coefficient(joint, qd):  # type: ignore[no-untyped-def]
    """Return the friction of a joint per rate [N m s/rad]."""
    return joint[3] + joint[4] / math.sqrt(qd * qd + SMOOTHING_SPEED * SMOOTHING_SPEED)


@helper
def _servo_law(joint, demand, q, qd, reference, law):  # type: ignore[no-untyped-def]
    """Advance the reference (2,) by one step; write to law (6,) the torques at zero acceleration.

    The torques are those of servo, friction and end stop, each followed by its damping.
    """
    mode, set_point, speed, acceleration = demand
    most, r, v = joint[2], q, qd
    law[0] = law[1] = 0.0
    if mode == MODE_CURRENT:
        law[0] = min(max(set_point, -most), most)
    elif mode != MODE_OFF:
        goal = profile_goal(mode, set_point, joint[0], joint[1], reference[0])
        r, v = advance_profile(goal, speed, acceleration, reference[0], reference[1])
        law[0], law[1] = -STIFFNESS * (q + STEP * qd - r) - DAMPING * (qd - v), DAMPING
    reference[0], reference[1] = r, v
    law[3] = _friction_coefficient(joint, qd)
    law[2] = -law[3] * qd
    law[4], law[5] = _end_stop(joint, q, qd)


@helper
def _joint_torque(joint, q, qd, qdd, reference, law, torques):  # type: ignore[no-untyped-def]
    """Return the torque between the bodies; write motor and transmitted torque to torques (2,)."""
    most, follows = joint[2], law[1] > 0.0
    friction, stop = law[2] - STEP * law[3] * qdd, law[4] - STEP * law[5] * qdd
    if follows:
        rate = qd + STEP * qdd
        friction = -_friction_coefficient(joint, rate) * rate
    command_torque = law[0] - STEP * law[1] * qdd - (friction if follows else 0.0)
    motor = min(max(command_torque, -most), most)
    if motor != command_torque:
        # The torque is saturated: the reference continues from the joint's position.
        reference[0] = q + STEP * qd + (motor + friction) / STIFFNESS
        reference[1] = qd
    torques[0], torques[1] = motor, motor + friction
    return motor + friction + stop


@helper
def apply_drives(  # type: ignore[no-untyped-def]
    bodies,
    forces,
    joints,
    demand,
    q,
    qd,
    reference,
    z,
    start_vectors,
    work,
    dz,
    inertia,
    requested,
    laws,
    torques,
):
    """Add the joint torques of the next step to forces.held, and write torques (n, 2).

    With the damping D of the terms predicted one step ahead, (A + STEP D) v' = forces(v' = 0).
    inertia (2, m), requested (m,), laws (n, 6) and the arrays passed to _derivative are scratch.
    """
    n, held = demand.shape[0], forces.held
    for k in range(n + 1):
        inertia[0, k], inertia[1, k] = bodies.inertia[0, k], bodies.inertia[1, k]
        requested[k] = held[k]
    for j in range(n):
        law = laws[j]
        _servo_law(joints[j], demand[j], q[3 + j], qd[3 + j], reference[j], law)
        # A servo compensates the friction.
        follows = law[1] > 0.0
        applied = law[0] + law[4] + (0.0 if follows else law[2])
        damping = STEP * (law[1] + law[5] + (0.0 if follows else law[3]))
        requested[j] -= applied
        requested[j + 1] += applied
        inertia[0, j] += damping
        inertia[0, j + 1] += damping
        inertia[1, j + 1] -= damping
    damped = Bodies(bodies.p, bodies.mass, bodies.arms, inertia)
    tried = Forces(forces.around, forces.thrust, requested, forces.torque)
    write_derivative_called(damped, tried, start_vectors, z, work, dz)
    for j in range(n):
        qdd = dz[1, 3 + j] - dz[1, 2 + j]
        applied = _joint_torque(
            joints[j], q[3 + j], qd[3 + j], qdd, reference[j], laws[j], torques[j]
        )
        held[j] -= applied
        held[j + 1] += applied
