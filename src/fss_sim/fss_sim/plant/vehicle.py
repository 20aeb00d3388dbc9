"""Model of a vehicle: base and arm floating on the table, with drives and thrusters."""

from cmath import exp
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import edge_clearance
from fss_arm_model.description import Arm, Base
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target, payload_pose, payload_state, with_payload
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.layout import BASE_SIZE, COM_X, COM_Y, LENGTH, MASS, each
from fss_arm_model.momentum import momentum
from fss_sim.plant.contact import Contact, Part
from fss_sim.plant.drives import MODE_CURRENT, MODE_OFF, MODE_POSITION, MODE_VELOCITY
from fss_sim.plant.joints import Joints
from fss_sim.plant.simulation import EMPTY_SCENE, advance
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Fingers, Gripper, PassiveTarget, rotors_inertia
from fss_sim.plant.thrusters import VALVES_CLOSED, Propulsion, Thrusters

Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]
BLOCKED_FRICTION = 1000.0  # Coulomb friction of a blocked joint [N m]
MODES = (MODE_OFF, MODE_CURRENT, MODE_VELOCITY, MODE_POSITION)


class Demand(NamedTuple):
    """Command to a servo drive, in terms of the joint."""

    mode: int  # 0 off, 1 current, 11 velocity, 21 position
    set_point: float = 0.0  # [A], [rad/s] or [rad], depending on the mode
    speed: float = 0.0  # of the profile [rad/s]; position mode at 0: come to rest and hold
    acceleration: float = 1.0  # of the profile [rad/s^2], above 0


class Motion(NamedTuple):
    """State of one joint at one instant."""

    q: float  # encoder angle; behind a flexible gear, that of the motor [rad]
    qd: float  # [rad/s]
    current: float  # of the motor; positive drives the joint counter-clockwise [A]
    torque: float  # transmitted by the gear, without friction [N m]
    shear: float = 0.0  # force transmitted by the joint, perpendicular to the link [N]


@dataclass(frozen=True)
class World:
    """Parameters of the plant, except those of the arm."""

    joints: Joints = field(default_factory=Joints)
    surroundings: Surroundings = field(default_factory=Surroundings)
    propulsion: Propulsion = field(default_factory=Propulsion)
    gripper: Gripper = field(default_factory=Gripper)
    target: Target | None = None
    tolerance: float = 0.0  # of the error control; 0: fixed steps
    contact: Contact | None = field(default_factory=Contact)  # None: bodies never touch


class Vehicle:
    """Base and links that float in the plane, with drives, thrusters and gripper.

    Args:
        arm: true parameters, for a base with a full tank; a Base has no arm.
        q: (3 + n,) initial state: base x, y [m], theta [rad], joints [rad].
        qd: (3 + n,) initial velocity; at rest by default.
        world: parameters of the plant, except those of the arm.
        propellant: propellant used before the start [kg].
        name: prefix of the names of its parts.
    """

    def __init__(
        self,
        arm: Arm | Base,
        q: npt.ArrayLike,
        qd: npt.ArrayLike | None = None,
        world: World | None = None,
        propellant: float = 0.0,
        name: str = "",
    ) -> None:
        self.arm, self.world, self.name = arm, world or World(), name
        links = arm.links if isinstance(arm, Arm) else ()
        self.n = len(links)
        self.thrusters = Thrusters(self.world.propulsion, propellant)
        self.closed, self.fingers = False, Fingers()  # commanded and actual state of the gripper
        self.held: PassiveTarget | Vehicle | None = None
        self.payload: PassiveTarget | None = None  # held target that is part of the last link
        self._payload_pose = np.zeros(3)  # of the payload, in the last link's frame
        self.step = 0  # steps since the start
        self._p = arm.vector()
        self._p[MASS] -= propellant
        joints = self.world.joints
        common = joints.viscous, joints.coulomb, joints.stop_stiffness, joints.stop_damping
        *gears, rest = joints.gears(self._p)
        self._gears, self._rest = np.array([*joints.rotor, *gears]), rest
        self._torque_constant = np.array([k.drive.torque_constant for k in links])
        self._joints = np.array(
            [
                (k.q_min, k.q_max, k.drive.torque_constant * k.drive.max_current, *common)
                for k in links
            ]
        ).reshape(-1, 7)
        self._rotors = rotors_inertia(3 + self.n, joints.rotor, bool(joints.stiffness))
        self._surroundings = self.world.surroundings.vector()
        self._pads = self.world.surroundings.vector(floats=False)
        self._demand = np.tile(np.array([MODE_OFF, 0.0, 0.0, 1.0]), (self.n, 1))
        if np.shape(q) != (3 + self.n,):
            raise ValueError(
                f"q has shape {np.shape(q)}, expected ({3 + self.n},): x, y and heading of the "
                f"base, and {self.n} joint angles"
            )
        state, none = np.zeros((2, 3 + self.n)), np.zeros(2 * self.n + 8)
        state[0], state[1] = q, 0.0 if qd is None else qd
        reference = state[:, 3:].T
        motors = np.column_stack([reference, np.zeros(self.n)])
        self.snapshot = np.concatenate([state.ravel(), reference.ravel(), motors.ravel(), none])

    @property
    def p(self) -> Floats:
        """Present Arm.vector(): without used propellant, with a held target in the last link."""
        return self._p

    @property
    def q(self) -> Floats:
        """State (3 + n,): base x, y [m], theta [rad], joints [rad]."""
        return self._state[0]

    @property
    def qd(self) -> Floats:
        """Velocity of the state (3 + n,)."""
        return self._state[1]

    def command(self, joint: int, demand: Demand) -> None:
        """Command the drive of a joint; joints are counted from 0.

        Raises:
            ValueError: there is no such joint, or the demand is not a Demand of finite numbers.
        """
        if not 0 <= joint < self.n:
            raise ValueError(f"joint is {joint}, expected 0 to {self.n - 1}: counted from 0")
        if not isinstance(demand, Demand) or demand.mode not in MODES:
            raise ValueError(
                f"demand is {demand!r}, expected Demand(mode, set_point, speed, acceleration) with "
                "a mode MODE_OFF, MODE_CURRENT, MODE_VELOCITY or MODE_POSITION of plant.drives"
            )
        if not all(map(isfinite, demand)):
            raise ValueError(f"demand is {demand!r}, expected finite numbers")
        mode, set_point, speed, acceleration = demand
        scale = self._torque_constant[joint] if mode == MODE_CURRENT else 1.0
        self._demand[joint] = mode, scale * set_point, speed, acceleration

    def block(self, joint: int, is_blocked: bool) -> None:
        """Block a joint by a very large friction, or free it; joints are counted from 0."""
        self._joints[joint, 4] = BLOCKED_FRICTION if is_blocked else self.world.joints.coulomb

    def thrust(self, on_times: Sequence[float]) -> None:
        """Open each thruster's valve for a time [s].

        Raises:
            ValueError: if there are not eight times, or one is negative or not finite.
        """
        self.thrusters.command(on_times, self.step)

    def motion(self, joint: int) -> Motion:
        """Return the motion of one joint, as its instruments see it."""
        return self.motions()[joint]

    def motions(self) -> list[Motion]:
        """Return the motion of each joint."""
        motor, transmitted = self._torques.T
        turning = self._motors[:, :2].T if self.world.joints.stiffness else self._state[:, 3:]
        rows = [*turning, motor / self._torque_constant, transmitted]
        return [Motion(*row) for row in np.stack(rows, axis=1).tolist()]

    @property
    def base(self) -> Pose:
        """Pose of the base in the world frame; its heading counts full turns."""
        x, y, theta = self.q[:3].tolist()
        return x, y, theta

    @property
    def tip(self) -> Pose:
        """Pose of the end effector in the base frame."""
        x, y, theta = tip_in_base(self._p, self.q[3:]).tolist()
        return x, y, theta

    @property
    def holds(self) -> bool:
        """Return True if the gripper holds something."""
        return self.held is not None

    @property
    def valves(self) -> list[bool]:
        """State of each thruster's valve; True: open."""
        return self.thrusters.open_valves(self.step)

    @property
    def edge_clearance(self) -> float:
        """Least gap between base or arm and the table's edge [m]; below 0 the border pushes."""
        around = self.world.surroundings
        if not self.n:
            half = 0.5 * np.array(around.table)
            return float(np.min(half - abs(self.q[:2]))) - around.base_radius
        radii = around.base_radius, around.link_radius
        return float(edge_clearance(self._p, self.q, around.table, *radii))

    def momentum(self) -> Floats:
        """Return linear [kg m/s] and angular momentum about the centre of mass [kg m^2/s], (3,).

        This includes base, arm and a held target, but not the rotors.
        """
        return momentum(self._p, self.q, self.qd)

    def payload_state(self) -> Floats:
        """Return pose and twist of the payload, (2, 3)."""
        return payload_state(self._p, self.q, self.qd, self._payload_pose)

    @property
    def snapshot(self) -> Floats:
        """State that a step changes (simulation.py)."""
        return self._snapshot

    @snapshot.setter
    def snapshot(self, snapshot: Floats) -> None:
        n, self._snapshot = self.n, snapshot
        at = 6 + 2 * n
        self._state, joints = snapshot[:at].reshape(2, 3 + n), snapshot[at:]
        self._reference = joints[: 2 * n].reshape(n, 2)
        self._motors = joints[2 * n : 5 * n].reshape(n, 3)
        self._torques = joints[5 * n : 7 * n].reshape(n, 2)
        self.audit_rows = joints[7 * n :].reshape(2, 4)

    def parts(self) -> list[Part]:
        """Return the parts that can touch others.

        For contacts with other chains, the last link is divided into link and gripper.
        """
        around, name = self.world.surroundings, f"{self.name} " if self.name else ""
        parts = [Part(f"{name}base", 0, 0j, 0j, around.base_radius)]
        radius, lengths = around.link_radius, each(self._p, LENGTH).tolist()
        for k, length in enumerate(lengths, 1):
            parts.append(Part(f"{name}link {k}", k, 0j, length, radius, outer=k < self.n))
        if self.n:
            start = max(0.0, lengths[-1] - self.world.gripper.length)
            parts += [
                Part(f"{name}link {self.n}", self.n, 0j, start, radius, inner=False),
                Part(f"{name}gripper", self.n, start, length, 0.0, inner=False, gripper=True),
            ]
        if self.payload:
            at, radius = complex(*self._payload_pose[:2]), self.payload.target.radius
            parts.append(Part(self.payload.name, self.n, at, at, radius, held=True))
        return parts

    def inertia(self) -> Floats:
        """Return the inertia that an impulse acts on, (3 + n, 3 + n).

        Rotors behind flexible gears keep their spin and are not part of it.
        """
        return inertia_matrix(self._p, self.q) + self._rotors

    def add_velocity(self, change: Floats) -> None:
        """Add an instantaneous change to the velocity."""
        self.snapshot = self._snapshot.copy()
        self._state[1] += change
        if self.world.joints.stiffness:  # rotors keep their spin: their relative rates change
            self._motors[:, 1] -= np.cumsum(change[2:])[:-1] / self.world.joints.gear_ratio

    def constants(self, first_step: int) -> Floats:
        """Return the constants of the steps from `first_step` on, see simulation.advance."""
        tank = self.thrusters
        around = self._surroundings if tank.floats else self._pads
        valves = tank.valves(first_step) if tank.is_active(first_step) else VALVES_CLOSED
        joints = self._rest, self._joints.ravel(), self._demand.ravel()
        return np.concatenate([self._p, self._gears, around, valves.ravel(), *joints])

    def update_audit(self) -> None:
        """Update the audit of momentum and energy after a change of state or mass."""
        advance([self], EMPTY_SCENE, 0, self.step)

    def end_steps(self, steps: int) -> None:
        """Count the past steps, and take the gas that bearings and thrusters used in them."""
        start, tank = self.step, self.thrusters
        self.step += steps
        used = tank.use_propellant(start, steps) if tank.is_active(start) else 0.0
        used += tank.use_bearing_air(steps)
        if not used:
            return
        self._p[MASS] -= used
        (x, y, heading, *_), (vx, vy, omega, *_) = self._state.tolist()
        com = complex(*self._p[COM_X : COM_Y + 1]) * exp(1j * heading)
        x, y, vx, vy = x + com.real, y + com.imag, vx - omega * com.imag, vy + omega * com.real
        self.audit_rows -= used * np.array([vx, vy, x * vy - y * vx, 0.5 * (vx * vx + vy * vy)])

    def attach(self, target: PassiveTarget, velocity: Floats | None = None) -> None:
        """Make the target part of the last link; set the vehicle's velocity (3 + n,) if given."""
        self._payload_pose = payload_pose(self._p, self.q, target.q)
        self._p = with_payload(self._p, target.target, self._payload_pose)
        self.held = self.payload = target
        target.attach(self.payload_state)
        if velocity is not None:
            self.add_velocity(velocity - self.qd)
        self.update_audit()

    def detach(self, target: PassiveTarget) -> None:
        """Release the target so that it floats freely; momentum and energy are conserved."""
        state, self.payload, self.held = target.state, None, None
        self._p = np.concatenate([self._p[:BASE_SIZE], self.arm.vector()[BASE_SIZE:]])
        self.update_audit()
        target.set_free(state)

    def let_slide(self, target: PassiveTarget, state: Floats) -> None:
        """Let the held target float freely from this state on, although the fingers hold it."""
        self.detach(target)
        self.held, self.fingers.slides = target, True
        target.set_free(state)
