"""Batch of arms on floating bases, advanced by the compiled rollout.

The bodies float freely: no friction, no contact, no noise. Each drive makes its joint follow a
commanded rate within its limits of torque, velocity and acceleration.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import bias, inertia_matrix
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_model.rollout import rollout

PERIOD = 0.05  # of the commands [s]
STEPS = 10  # of the integration in a period
# Drives brake a joint that is this close to a limit and moves towards it.
LIMIT_MARGIN = 0.1  # [rad]


class Batch:
    """States of N equal arms, whose parameters may differ.

    Args:
        arm: description; `p` starts with its parameters.
        count: N.

    Attributes:
        p: (N, 8 + 6 n) Arm.vector() of each.
        q: (N, 3 + n) base x, y [m], heading [rad], joints [rad].
        qd: (N, 3 + n) its rate.
        torque: (N, n) torques of the drives in the last period [N m].
    """

    def __init__(self, arm: Arm, count: int) -> None:
        self.arm, self.n = arm, arm.n
        drives = [link.drive for link in arm.links]
        self.max_rate = np.array([drive.max_velocity for drive in drives])
        self.max_acceleration = np.array([drive.max_acceleration for drive in drives])
        self.max_torque = np.array([drive.max_torque for drive in drives])
        self.q_min = np.array([link.q_min for link in arm.links])
        self.q_max = np.array([link.q_max for link in arm.links])
        self.p = np.tile(arm.vector(), (count, 1))
        self.q, self.qd = np.zeros((2, count, 3 + arm.n))
        self.torque = np.zeros((count, arm.n))

    def advance(self, wrench: npt.ArrayLike, rates: npt.ArrayLike) -> None:
        """Advance by one period.

        Args:
            wrench: (N, 3) force on the base's origin in its own axes [N], torque [N m].
            rates: (N, n) commanded rates of the joints [rad/s].
        """
        on_base = rotated(np.asarray(wrench, dtype=float), self.q[:, 2])
        self.torque = self._servo_torque(on_base, self._limited(np.asarray(rates, dtype=float)))
        tau = np.concatenate([on_base, self.torque], axis=1)
        held = np.repeat(tau[:, None], STEPS, axis=1)
        q, qd = rollout(self.p, self.q, self.qd, held, PERIOD / STEPS)
        self.q, self.qd = q[:, -1].copy(), qd[:, -1].copy()

    def _limited(self, rates: Floats) -> Floats:
        """Return the rates within the drives' limits, zero towards a near end of the range."""
        rates = np.clip(rates, -self.max_rate, self.max_rate)
        low = np.where(self.q[:, 3:] < self.q_min + LIMIT_MARGIN, 0.0, -np.inf)
        high = np.where(self.q[:, 3:] > self.q_max - LIMIT_MARGIN, 0.0, np.inf)
        return np.clip(rates, low, high)

    def _servo_torque(self, on_base: Floats, rates: Floats) -> Floats:
        """Return the torques that give the joints these rates at the end of a period, (N, n).

        With the joints' accelerations given, the base's follow from its rows of
        H qdd + h = tau, and the torques from the joints' rows.
        """
        H, h = inertia_matrix(self.p, self.q), bias(self.p, self.q, self.qd)
        qdd = (rates - self.qd[:, 3:]) / PERIOD
        qdd = np.clip(qdd, -self.max_acceleration, self.max_acceleration)
        unbalanced = on_base - h[:, :3] - _product(H[:, :3, 3:], qdd)
        base = np.linalg.solve(H[:, :3, :3], unbalanced[..., None])[..., 0]
        torque = _product(H[:, 3:, :3], base) + _product(H[:, 3:, 3:], qdd) + h[:, 3:]
        return np.clip(torque, -self.max_torque, self.max_torque)

    def tip(self) -> tuple[Floats, Floats]:
        """Return pose and twist of the end effectors, (N, 3) each, in world axes."""
        return tip_pose(self.p, self.q), _product(tip_jacobian(self.p, self.q), self.qd)


def rotated(planar: Floats, angle: Floats) -> Floats:
    """Return planar vectors (N, 3), turned by angles (N,) [rad]; the third component stays."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = planar[:, 0], planar[:, 1]
    return np.stack([c * x - s * y, s * x + c * y, planar[:, 2]], axis=1)


def wrapped(angle: Floats) -> Floats:
    """Return angles [rad] from -pi to pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _product(matrices: Floats, vectors: npt.NDArray[Any]) -> Floats:
    """Return the products of matrices (N, a, b) and vectors (N, b), (N, a)."""
    return np.einsum("nab,nb->na", matrices, vectors)
