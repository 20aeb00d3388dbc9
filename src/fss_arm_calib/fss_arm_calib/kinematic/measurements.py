"""Measurements of rests for the joint estimate: end-effector poses relative to the base."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fss_arm_calib.estimation.least_squares import Linear
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import problem_of
from fss_arm_calib.segments.rests import Observation
from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_regressor


@dataclass(frozen=True)
class RestMeasurements:
    """Measurements of rests, which have no unknowns of their own."""

    problem: KinematicProblem

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates of the poses."""
        return self.problem.tip.size

    def initial_unknowns(self) -> Floats:
        """Return an empty vector: rests have no unknowns of their own."""
        return np.empty(0)

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the pose residuals near z, divided by their standard deviations."""
        problem, n = self.problem, self.problem.arm.n
        p = z[: layout.size(n)]
        J = np.zeros((*problem.tip.shape, len(z)))
        J[..., layout.kinematic_index(n)] = tip_regressor(p, problem.q)
        J[:, 2, layout.TIP_ANGLE] = 1.0
        r = model.whiten_residuals(problem, model.pose_errors(problem, p)).ravel()
        rows = model.whiten(problem, J).reshape(len(r), len(z))
        return Linear(r, rows, r @ r, lambda dz: dz)


def measurements(
    rests: Sequence[Observation], arm: Arm, settings: KinematicSettings
) -> RestMeasurements:
    """Return the measurements of rests.

    Raises:
        ValueError: the rests do not match the arm.
    """
    return RestMeasurements(problem_of(rests, arm, settings))
