"""The test bed itself: base and arm floating on the table, their drives and thrusters, a target."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.clearance import clearance, edge_clearance
from fss_arm_model.description import Arm
from fss_arm_model.held import Approach, Target, approach, held, hold, with_held
from fss_arm_model.integration import STEP
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.layout import BASE_SIZE, MASS
from fss_arm_model.momentum import momentum
from fss_sim.plant.drives import CURRENT, OFF
from fss_sim.plant.joints import Joints
from fss_sim.plant.simulation import advance, advance_geared
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper, caught
from fss_sim.plant.thrusters import Propulsion, Thrusters

Floats = npt.NDArray[np.float64]
Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]


class Demand(NamedTuple):
    """What a servo drive is commanded, seen from the joint."""

    mode: int  # 0 off, 1 current, 11 velocity, 21 position
    set_point: float = 0.0  # [A], [rad/s] or [rad], by mode
    speed: float = 0.0  # of the profile [rad/s]; position mode at 0: come to rest and hold
    acceleration: float = 1.0  # of the profile [rad/s^2], above 0


class Motion(NamedTuple):
    """One joint at an instant."""

    q: float  # encoder angle, the motor's behind a gear that gives [rad]
    qd: float  # [rad/s]
    current: float  # of the motor, driving the joint counter-clockwise if positive [A]
    torque: float  # that passes the gear, friction taken off [N m]
    shear: float = 0.0  # force across the link that passes the joint [N]


class Audit(NamedTuple):
    """Books on momentum and energy; what is there, less what was given, stays what it was."""

    momentum: Floats  # linear, x and y [N s], and angular about the world's origin [N m s]
    energy: float  # kinetic, and of the gears' springs [J]
    impulse: Floats  # (3,) given from outside since the begin, and carried away by propellant
    work: float  # done since the begin by all forces, those of a capture too [J]

    @property
    def balance(self) -> Floats:
        """What never changes, (4,)."""
        return np.append(self.momentum - self.impulse, self.energy - self.work)


@dataclass(frozen=True)
class World:
    """All that the plant is made of beside the arm."""

    joints: Joints = field(default_factory=Joints)
    surroundings: Surroundings = field(default_factory=Surroundings)
    propulsion: Propulsion = field(default_factory=Propulsion)
    gripper: Gripper = field(default_factory=Gripper)
    target: Target | None = None
    tolerance: float = 0.0  # of error control; 0: fixed steps


class Plant:
    """Base and links, floating in the plane, and a target that does too.

    Args:
        arm: the true parameters, the base with its tank full.
        q: (3 + n,) state at the begin: base x, y [m], theta [rad], joints [rad].
        qd: (3 + n,) its velocity; at rest by default.
        world: what there is beside the arm.
        target: (2, 3) pose and twist of the target at the begin, if there is one.
        holds: whether the gripper holds it.
        propellant: used before [kg].
    """

    def __init__(
        self,
        arm: Arm,
        q: npt.ArrayLike,
        qd: npt.ArrayLike | None = None,
        world: World | None = None,
        target: npt.ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        holds: bool = False,
        propellant: float = 0.0,
    ) -> None:
        self.arm, self.world = arm, world or World()
        self.thrusters = Thrusters(self.world.propulsion, propellant)
        self.closed = holds  # the gripper, as commanded
        self._place: Floats | None = None  # of the target in the frame of the link that holds it
        self._p, self._step = arm.vector(), 0
        self._p[MASS] -= propellant
        joints = self.world.joints
        alike = joints.viscous, joints.coulomb, joints.stop_stiffness, joints.stop_damping
        self._gears = joints.gears(self._p)
        self._torque_constant = np.array([k.drive.torque_constant for k in arm.links])
        self._joints = np.array(
            [
                (k.q_min, k.q_max, k.drive.torque_constant * k.drive.max_current, *alike)
                for k in arm.links
            ]
        )
        self._surroundings = self.world.surroundings.vector()
        self._demand = np.tile(np.array([OFF, 0.0, 0.0, 1.0]), (arm.n, 1))
        self._state = np.zeros((2, 3 + arm.n))
        self._state[0] = q
        self._state[1] = 0.0 if qd is None else qd
        self._reference = self._state[:, 3:].T.copy()
        self._motors = np.column_stack([self._reference, np.zeros(arm.n)])
        self._audit, self._torques = np.zeros((2, 4)), np.zeros((arm.n, 2))
        self._target, self._target_audit = np.array(target, dtype=float), np.zeros((2, 4))
        if holds and self.world.target:
            self._place = hold(self._p, self.q, self._target[0])
            self._p = with_held(self._p, self.world.target, self._place)
        self._pass(0)
        self._begin = self.audit.balance

    @property
    def p(self) -> Floats:
        """Arm.vector() as it is now: less propellant, and what is held with the last link."""
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
        """Command the drive of a joint, counted from 0, from now on."""
        mode, set_point, speed, acceleration = demand
        scale = self._torque_constant[joint] if mode == CURRENT else 1.0
        self._demand[joint] = mode, scale * set_point, speed, acceleration

    def thrust(self, on_times: Sequence[float]) -> None:
        """Open the thrusters' valves for a time each [s].

        Raises:
            ValueError: there are not eight times, or one is not a number from 0 on.
        """
        self.thrusters.command(on_times, self._step)

    def advance(self, seconds: float) -> None:
        """Let time pass, in whole steps of the drives."""
        if self.closed and not self.holds and self.world.gripper.takes(self.approach):
            self._catch()
        elif not self.closed and self.holds:
            self._release()
        steps = round(seconds / STEP)
        begin, self._step = self._step, self._step + steps
        if not self.thrusters.busy(begin):
            self._pass(steps)
            return
        self._pass(steps, self.thrusters.valves(begin))
        spent = self.thrusters.spend(begin, steps)
        had = self._audit[0].copy()
        self._p[MASS] -= spent
        self._pass(0)
        self._audit[1] += self._audit[0] - had

    def motion(self, joint: int) -> Motion:
        """What the instruments of a link are exposed to."""
        return self.motions()[joint]

    def motions(self) -> list[Motion]:
        """The motion of each joint."""
        motor, passed = self._torques.T
        turning = self._motors[:, :2].T if self.world.joints.stiffness else self._state[:, 3:]
        rows = [*turning, motor / self._torque_constant, passed]
        return [Motion(*row) for row in np.stack(rows, axis=1).tolist()]

    @property
    def base(self) -> Pose:
        """The base in the world; its heading counts turns."""
        x, y, theta = self.q[:3].tolist()
        return x, y, theta

    @property
    def tip(self) -> Pose:
        """The end effector in the frame of the base."""
        x, y, theta = tip_in_base(self._p, self.q[3:]).tolist()
        return x, y, theta

    @property
    def target(self) -> Floats:
        """Pose and twist of the target in the world, (2, 3)."""
        if self._place is None:
            return self._target
        return held(self._p, self.q, self.qd, self._place)

    @property
    def holds(self) -> bool:
        """Whether the gripper holds the target."""
        return self._place is not None

    @property
    def approach(self) -> Approach:
        """The end effector as seen from the target's fixture; infinitely far without a target."""
        if self.world.target is None:
            return Approach(np.inf, 0.0, 0.0)
        return approach(self._p, self.q, self.qd, self.world.target, self.target)

    @property
    def valves(self) -> list[bool]:
        """Which thrusters' are open."""
        return self.thrusters.open(self._step)

    @property
    def clearance(self) -> float:
        """The least gap between two bodies of base and arm that are not neighbours [m]."""
        around = self.world.surroundings
        return float(clearance(self._p, self.q, around.base_radius, around.link_radius))

    @property
    def edge_clearance(self) -> float:
        """The least gap between base or arm and the table's edge [m]; below 0 the border pushes."""
        around = self.world.surroundings
        radii = around.base_radius, around.link_radius
        return float(edge_clearance(self._p, self.q, around.table, *radii))

    @property
    def audit(self) -> Audit:
        """The books of all bodies as they are now."""
        has, given = self._audit + self._target_audit
        return Audit(has[:3], float(has[3]), given[:3], float(given[3]))

    @property
    def imbalance(self) -> Floats:
        """What the books are off by since the begin, (4,) [N s, N s, N m s, J]."""
        return self.audit.balance - self._begin

    def momentum(self) -> Floats:
        """Linear [kg m/s] and, about the centre of mass, angular momentum [kg m^2/s]: (3,).

        Of base and arm, what they hold included, and the rotors left out.
        """
        return momentum(self._p, self.q, self.qd)

    def _pass(self, steps: int, valves: npt.ArrayLike = ((0.0,) * 5,)) -> None:
        """Let steps pass; none: renew the books."""
        world, around = self.world, self._surroundings
        rotor = world.joints.rotor
        if world.joints.stiffness:
            self._state, self._reference, self._motors, self._audit, torques = advance_geared(
                self._p, rotor, self._joints, self._gears, around, valves, self._demand,
                self._state, self._reference, self._motors, self._audit, steps, world.tolerance,
            )  # fmt: skip
        else:
            self._state, self._reference, self._audit, torques = advance(
                self._p, rotor, self._joints, around, valves, self._demand, self._state,
                self._reference, self._audit, steps, world.tolerance,
            )  # fmt: skip
        self._torques = torques if steps else self._torques
        if world.target and not self.holds:
            none, shut = np.zeros((0, 2)), ((0.0,) * 5,)
            self._target, _, self._target_audit, _ = advance(
                world.target.vector(), (0.0, 0.0), np.zeros((0, 7)), around, shut,
                np.zeros((0, 4)), self._target, none, self._target_audit, steps, world.tolerance,
            )  # fmt: skip

    def _catch(self) -> None:
        """Close the gripper on the target: momentum stays, the energy lost is booked."""
        target, p, joints = self.world.target, self._p, self.world.joints
        assert target is not None
        rotor = (0.0, 0.0) if joints.stiffness else joints.rotor  # a spring passes no impulse on
        had = self._audit[0] + self._target_audit[0]
        given = self._audit[1] + self._target_audit[1]
        self._place = hold(p, self.q, self._target[0])
        self._state[1] = caught(p, self.q, self.qd, rotor, target, self._target)
        self._p = with_held(p, target, self._place)
        self._target_audit = np.zeros((2, 4))
        self._pass(0)
        self._audit[1] = given
        self._audit[1, 3] += self._audit[0, 3] - had[3]

    def _release(self) -> None:
        """Let the target go; nothing is lost."""
        self._target, self._place = self.target, None
        self._p = np.concatenate([self._p[:BASE_SIZE], self.arm.vector()[BASE_SIZE:]])
        self._pass(0)
