"""Constraint between two arms that hold each other, or the same target."""

from dataclasses import dataclass, field

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.integration import STEP
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_sim.plant.vehicle import Vehicle

POSE_TOLERANCE = 1e-8  # tolerance of the relative pose at the end of a step [m, rad]


@dataclass
class Weld:
    """Rigid connection of two arms: their last links move as one body."""

    one: Vehicle
    other: Vehicle
    relative_pose: Floats = field(
        init=False
    )  # (3,) pose of the tip of `other` in the frame of one's tip
    goal: Floats = field(default_factory=lambda: np.zeros(3))  # its velocity at a step's start
    impulse: Floats = field(default_factory=lambda: np.zeros(3))  # of the last step [N s, N m s]
    sensitivity: Floats = field(default_factory=lambda: STEP * np.eye(3))  # d(pose error) / d(goal)
    previous: tuple[Floats, Floats] | None = None  # previous goal in this step, and its pose error

    def __post_init__(self) -> None:
        (x, y, turn), (u, v, other) = self._tips()
        apart = complex(u - x, v - y) * np.exp(-1j * turn)
        self.relative_pose = np.array([apart.real, apart.imag, other - turn])

    def _tips(self) -> tuple[Floats, Floats]:
        return tip_pose(self.one.p, self.one.q), tip_pose(self.other.p, self.other.q)

    def pose_error(self) -> Floats:
        """Return the pose error of the tip of `other`, (3,) [m, m, rad]."""
        (x, y, turn), (u, v, other) = self._tips()
        apart = complex(*self.relative_pose[:2]) * np.exp(1j * turn)
        return np.array(
            [u - x - apart.real, v - y - apart.imag, other - turn - self.relative_pose[2]]
        )

    def correct_goal(self) -> bool:
        """Correct the goal by the pose error at the end of the step, by Broyden's method.

        Return False if the error is within the tolerance. The method is needed because a servo
        that holds its joint lets the tip move by less than the velocity times the step.
        """
        error, previous = self.pose_error(), self.previous
        self.previous = self.goal, error
        if previous is not None and (goal_change := self.goal - previous[0]).any():
            missed = error - previous[1] - self.sensitivity @ goal_change
            self.sensitivity = self.sensitivity + np.outer(missed, goal_change) / (
                goal_change @ goal_change
            )
        if abs(error).max() <= POSE_TOLERANCE:
            return False
        self.goal = self.goal - np.linalg.solve(self.sensitivity, error)
        return True

    def jacobians(self) -> tuple[Floats, Floats]:
        """Return both Jacobians (3, 3 + n): twist of each last link at the tip of `other`."""
        one, tip = self._tips()
        J = tip_jacobian(self.one.p, self.one.q)
        J[0] -= (tip - one)[1] * J[2]
        J[1] += (tip - one)[0] * J[2]
        return J, tip_jacobian(self.other.p, self.other.q)
