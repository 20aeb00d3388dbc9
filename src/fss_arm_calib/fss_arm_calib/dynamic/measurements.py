"""Measurements of maneuvers for the joint estimate: poses of the base."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import problem_of
from fss_arm_calib.estimation.least_squares import Linear
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm


@dataclass(frozen=True)
class ManeuverMeasurements:
    """Measurements of maneuvers; unknown for each are its pose and momentum at the start."""

    problem: DynamicProblem

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates of the poses, less the unknowns without a prior."""
        return int(self.problem.freedom_by_maneuver.sum())

    def initial_unknowns(self) -> Floats:
        """Return the initial guess: each maneuver starts at rest at its first observed pose."""
        return self.problem.start[len(self.problem.names) :]

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the residuals of the base's poses, divided by their standard deviations."""
        problem, size = self.problem, layout.size(self.problem.arm.n)
        states = np.zeros((len(problem.poses), 8))
        states[:, :3] = problem.poses[:, 0]
        states[:, problem.state_unknowns] = unknowns.reshape(len(states), -1)
        states[:, 6:] = z[size : size + 2]
        columns = np.zeros((size + 8, len(z)))
        columns[:size, :size] = np.eye(size)
        columns[-2:, size : size + 2] = np.eye(2)
        return problem.linearize_at(z[:size], states, columns)


def measurements(
    maneuvers: Sequence[Maneuver], arm: Arm, settings: DynamicSettings
) -> ManeuverMeasurements:
    """Return the measurements of maneuvers.

    Raises:
        ValueError: the maneuvers do not match the arm.
    """
    return ManeuverMeasurements(problem_of(maneuvers, arm, settings))
