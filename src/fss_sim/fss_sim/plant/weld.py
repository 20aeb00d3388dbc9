"""Constraint between two arms that hold each other, or the same target."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fss_arm_model.integration import STEP
from fss_arm_model.kernels import Floats
from fss_arm_model.kinematics import tip_jacobian, tip_pose

if TYPE_CHECKING:
    from fss_sim.plant.plant import Vehicle

WELD = 1e-8  # tolerance of the relative pose at the end of a step [m, rad]


@dataclass
class Weld:
    """Rigid connection of two arms: their last links move as one body."""

    one: "Vehicle"
    other: "Vehicle"
    place: Floats = field(init=False)  # (3,) pose of the tip of `other` in the frame of one's tip
    goal: Floats = field(default_factory=lambda: np.zeros(3))  # its velocity at a step's start
    impulse: Floats = field(default_factory=lambda: np.zeros(3))  # of the last step [N s, N m s]
    answer: Floats = field(default_factory=lambda: STEP * np.eye(3))  # d(pose error) / d(goal)
    last: tuple[Floats, Floats] | None = None  # previous goal in this step, and its pose error

    def __post_init__(self) -> None:
        (x, y, turn), (u, v, other) = self._tips()
        apart = complex(u - x, v - y) * np.exp(-1j * turn)
        self.place = np.array([apart.real, apart.imag, other - turn])

    def _tips(self) -> tuple[Floats, Floats]:
        return tip_pose(self.one.p, self.one.q), tip_pose(self.other.p, self.other.q)

    def off(self) -> Floats:
        """Return the pose error of the tip of `other`, (3,) [m, m, rad]."""
        (x, y, turn), (u, v, other) = self._tips()
        apart = complex(*self.place[:2]) * np.exp(1j * turn)
        return np.array([u - x - apart.real, v - y - apart.imag, other - turn - self.place[2]])

    def improve(self) -> bool:
        """Correct the goal by the pose error at the end of the step, by Broyden's method.

        Return False if the error is within the tolerance. The method is needed because a servo
        that holds its joint lets the tip move by less than the velocity times the step.
        """
        off, last = self.off(), self.last
        self.last = self.goal, off
        if last is not None and (tried := self.goal - last[0]).any():
            missed = off - last[1] - self.answer @ tried
            self.answer = self.answer + np.outer(missed, tried) / (tried @ tried)
        if abs(off).max() <= WELD:
            return False
        self.goal = self.goal - np.linalg.solve(self.answer, off)
        return True

    def jacobians(self) -> tuple[Floats, Floats]:
        """Return both Jacobians (3, 3 + n): twist of each last link at the tip of `other`."""
        one, tip = self._tips()
        J = tip_jacobian(self.one.p, self.one.q)
        J[0] -= (tip - one)[1] * J[2]
        J[1] += (tip - one)[0] * J[2]
        return J, tip_jacobian(self.other.p, self.other.q)
