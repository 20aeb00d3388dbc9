"""A second, passive spacecraft simulator on the table, and the gripper that can hold it.

While it is held, the target is part of the last link. At the capture the gripper closes at once,
plastically: an impulse between end effector and target makes their velocities alike, so that
momentum stays and energy is lost. With the target's centre of mass at J_t qd,

    (H + J_t' M_t J_t) qd_after = H qd_before + J_t' M_t v_t
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Approach, Target, held_jacobian, hold
from fss_arm_model.settings import NOT_NEGATIVE, Settings, setting

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Gripper(Settings):
    """How near, straight and slow the end effector must be to grip."""

    reach: float = setting(
        0.03, "largest distance of the gripper from what it grips", unit="m", check=NOT_NEGATIVE
    )
    angle: float = setting(
        0.5, "largest angle of the gripper against what it grips", unit="rad", check=NOT_NEGATIVE
    )
    speed: float = setting(
        0.1, "largest speed of what is gripped past the gripper", unit="m/s", check=NOT_NEGATIVE
    )

    def takes(self, approach: Approach) -> bool:
        """Whether it can close on a fixture that the end effector sees so."""
        return (
            approach.distance <= self.reach
            and abs(approach.angle) <= self.angle
            and approach.speed <= self.speed
        )


def caught(
    p: Floats, q: Floats, qd: Floats, rotor: tuple[float, float], target: Target, state: Floats
) -> Floats:
    """Velocity of the arm right after it has gripped the target at state (2, 3)."""
    H = inertia_matrix(p, q) + rotors_inertia(q.size, rotor)
    J = held_jacobian(p, q, hold(p, q, state[0]))
    M = np.array([target.mass, target.mass, target.inertia])
    gained = J.T @ (M * (state[1] - J @ qd))
    return qd + np.linalg.solve(H + J.T @ (M[:, None] * J), gained)


def rotors_inertia(size: int, rotor: tuple[float, float]) -> Floats:
    """What rotors add to H: N^2 J at their joint, N J between it and all that turns its stator."""
    H = np.zeros((size, size))
    for k in range(3, size):
        H[k, k] = rotor[0]
        H[k, 2:k] = H[2:k, k] = rotor[1]
    return H
