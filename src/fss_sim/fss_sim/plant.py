"""The test bed itself: base and arm floating on the table, driven by the links' servo drives."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.drives import CURRENT, OFF, STEP, advance
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import momentum

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
    torque: float  # at the joint, friction included [N m]


class Plant:
    """Base and links, free-floating in the plane; nothing acts from outside.

    Args:
        arm: the true parameters.
        q: (3 + n,) state at the begin: base x, y [m], theta [rad], joints [rad].
        qd: (3 + n,) its velocity; at rest by default.
    """

    def __init__(self, arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike | None = None) -> None:
        self.arm, self._p = arm, arm.vector()
        drives = [link.drive for link in arm.links]
        self._torque_constant = np.array([d.torque_constant for d in drives])
        torque = [d.torque_constant * d.max_current for d in drives]
        self._limits = np.array(
            [[k.q_min, k.q_max, t] for k, t in zip(arm.links, torque, strict=True)]
        )
        self._demand = np.tile(np.array([OFF, 0.0, 0.0, 1.0]), (arm.n, 1))
        self._state = np.zeros((3, 3 + arm.n))
        self._state[0] = q
        self._state[1] = 0.0 if qd is None else qd
        self._reference = self._state[:2, 3:].T.copy()

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
        self._state, self._reference = advance(
            self._p,
            self._limits,
            self._demand,
            self._state,
            self._reference,
            round(seconds / STEP),
        )

    def motion(self, joint: int) -> Motion:
        """What the instruments of a link are exposed to."""
        return self.motions()[joint]

    def motions(self) -> list[Motion]:
        """The motion of each joint."""
        q, qd, torque = self._state[:, 3:]
        current = np.where(self._demand[:, 0] == OFF, 0.0, torque / self._torque_constant)
        return list(map(Motion._make, np.stack([q, qd, current, torque], axis=1).tolist()))

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

    def momentum(self) -> Floats:
        """Linear [kg m/s] and, about the centre of mass, angular momentum [kg m^2/s]: (3,)."""
        return momentum(self._p, self.q, self.qd)
