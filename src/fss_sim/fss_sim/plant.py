"""The test bed itself: base and arm floating on the table, driven by the links' servo drives."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.drives import CURRENT, OFF
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import momentum
from fss_arm_model.simulation import STEP, Surroundings, advance

Floats = npt.NDArray[np.float64]
Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]


class Demand(NamedTuple):
    """What a servo drive is told to do, seen from the joint."""

    mode: int  # 0 off, 1 current, 11 velocity, 21 position
    set_point: float = 0.0  # [A], [rad/s] or [rad], by mode
    speed: float = 0.0  # of the profile [rad/s]; position mode at 0: come to rest and hold
    acceleration: float = 1.0  # of the profile [rad/s^2], above 0


class Motion(NamedTuple):
    """One joint at an instant."""

    q: float  # encoder angle [rad]
    qd: float  # [rad/s]
    current: float  # of the motor, driving the joint counter-clockwise if positive [A]
    torque: float  # that passes the gear, friction taken off [N m]


class Audit(NamedTuple):
    """Books on momentum and energy; what is there, less what was given, stays what it was."""

    momentum: Floats  # linear, x and y [N s], and angular about the world's origin [N m s]
    energy: float  # kinetic [J]
    impulse: Floats  # (3,) given from outside since the begin
    work: float  # done by all forces since the begin [J]


@dataclass(frozen=True)
class Joints:
    """The mechanics that all joints have in common."""

    rotor_inertia: float = 0.0  # of the motor, felt at the joint: N^2 J [kg m^2]
    gear_ratio: float = 30.0  # N
    viscous: float = 0.5  # friction [N m s/rad]
    coulomb: float = 0.3  # friction [N m]
    stop_stiffness: float = 2000.0  # of the end stops [N m/rad]; 0 and
    stop_damping: float = 20.0  # [N m s/rad] 0: there are none

    @property
    def rotor(self) -> tuple[float, float]:
        """N^2 J and N J [kg m^2]."""
        return self.rotor_inertia, self.rotor_inertia / self.gear_ratio


class Plant:
    """Base and links, floating in the plane.

    Args:
        arm: the true parameters.
        q: (3 + n,) state at the begin: base x, y [m], theta [rad], joints [rad].
        qd: (3 + n,) its velocity; at rest by default.
        joints: friction, rotors and end stops.
        surroundings: what acts from outside.
        tolerance: of error control; 0: fixed steps.
    """

    def __init__(
        self,
        arm: Arm,
        q: npt.ArrayLike,
        qd: npt.ArrayLike | None = None,
        joints: Joints | None = None,
        surroundings: Surroundings | None = None,
        tolerance: float = 0.0,
    ) -> None:
        self.arm, self._p = arm, arm.vector()
        joints = joints or Joints()
        drives = [link.drive for link in arm.links]
        self._torque_constant = np.array([d.torque_constant for d in drives])
        alike = joints.viscous, joints.coulomb, joints.stop_stiffness, joints.stop_damping
        self._joints = np.array(
            [
                (k.q_min, k.q_max, k.drive.torque_constant * k.drive.max_current, *alike)
                for k in arm.links
            ]
        )
        self._rotor = np.array(joints.rotor)
        self._surroundings = (surroundings or Surroundings()).vector()
        self._tolerance = tolerance
        self._demand = np.tile(np.array([OFF, 0.0, 0.0, 1.0]), (arm.n, 1))
        self._state = np.zeros((2, 3 + arm.n))
        self._state[0] = q
        self._state[1] = 0.0 if qd is None else qd
        self._reference = self._state[:, 3:].T.copy()
        self._audit, self._torques = np.zeros((2, 4)), np.zeros((arm.n, 2))
        self.advance(0.0)

    @property
    def q(self) -> Floats:
        """State (3 + n,): base x, y [m], theta [rad], joints [rad]."""
        return self._state[0]

    @property
    def qd(self) -> Floats:
        """Velocity of the state (3 + n,)."""
        return self._state[1]

    def command(self, joint: int, demand: Demand) -> None:
        """Tell the drive of a joint, counted from 0, what to do from now on."""
        mode, set_point, speed, acceleration = demand
        scale = self._torque_constant[joint] if mode == CURRENT else 1.0
        self._demand[joint] = mode, scale * set_point, speed, acceleration

    def advance(self, seconds: float) -> None:
        """Let time pass, in whole steps of the drives."""
        self._state, self._reference, self._audit, self._torques = advance(
            self._p,
            self._rotor,
            self._joints,
            self._surroundings,
            np.zeros((1, 5)),
            self._demand,
            self._state,
            self._reference,
            self._audit,
            round(seconds / STEP),
            self._tolerance,
        )

    def motion(self, joint: int) -> Motion:
        """What the instruments of a link are exposed to."""
        return self.motions()[joint]

    def motions(self) -> list[Motion]:
        """The motion of each joint."""
        motor, passed = self._torques.T
        rows = [*self._state[:, 3:], motor / self._torque_constant, passed]
        return list(map(Motion._make, np.stack(rows, axis=1).tolist()))

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
    def audit(self) -> Audit:
        """The books as they are now."""
        has, given = self._audit
        return Audit(has[:3], float(has[3]), given[:3], float(given[3]))

    def momentum(self) -> Floats:
        """Linear [kg m/s] and, about the centre of mass, angular momentum [kg m^2/s]: (3,).

        Without the rotors' part.
        """
        return momentum(self._p, self.q, self.qd)
