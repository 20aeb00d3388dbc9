"""Measurements of drifts for the joint estimate: base and arm move as one rigid body."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fss_arm_calib.drift.problem import DIFFERENCE_STEPS, mean_motion
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.drift.solution import pose_deviations
from fss_arm_calib.estimation.least_squares import Linear, eliminate
from fss_arm_calib.segments.drifts import Drift
from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.drifting import drift, single_body, single_body_sensitivities

UNKNOWNS_PER_DRIFT = 6  # unknowns of each drift: pose and twist at its start

#: Half differences as for a drift alone, then for mass and inertia of base and arm.
_STEPS = np.array([*DIFFERENCE_STEPS, 1e-3, 1e-4])


@dataclass(frozen=True)
class DriftMeasurements:
    """Measurements of drifts; unknown for each are its pose and twist at the start.

    The rigid body of base and arm follows from the arm's parameters.
    """

    drifts: Sequence[Drift]
    sigma: Sequence[Floats]  # (m, 3) standard deviations of each drift's poses
    n: int  # number of links

    @property
    def degrees_of_freedom(self) -> int:
        """Number of coordinates of the poses, less the drifts' own unknowns."""
        return sum(sigma.size - UNKNOWNS_PER_DRIFT for sigma in self.sigma)

    def initial_unknowns(self) -> Floats:
        """Return the initial guess: each drift has its mean twist."""
        return np.concatenate([mean_motion(one) for one in self.drifts])

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the residuals of the base's poses, divided by their standard deviations.

        The rows of each drift are reduced by a QR decomposition, without loss of information.
        """
        size = layout.size(self.n)
        p, acting, q = z[:size], z[size:], np.array([one.q for one in self.drifts])
        bodies, by_arm = single_body(p, q), single_body_sensitivities(p, q)
        count = len(_STEPS)
        few = np.empty((len(q), count + 1, count + 1))
        steps = _STEPS * np.vstack([np.zeros((1, count)), np.eye(count), -np.eye(count)])
        for k, one in enumerate(self.drifts):
            mass, inertia, *com = bodies[k]
            u = (
                np.array(
                    [
                        *acting,
                        *unknowns[UNKNOWNS_PER_DRIFT * k : UNKNOWNS_PER_DRIFT * (k + 1)],
                        *com,
                        mass,
                        inertia,
                    ]
                )
                + steps
            )
            poses = drift(u[:, [13, 14, 11, 12]], u[:, :5], u[:, 5:11], one.times)[..., :3]
            by = (poses[1 : count + 1] - poses[count + 1 :]) / (2.0 * _STEPS[:, None, None])
            off = np.array(one.poses) - poses[0]
            rows = np.concatenate([by, off[None]]) / self.sigma[k]
            few[k] = np.linalg.qr(rows.reshape(count + 1, -1).T, mode="r")
        A = np.zeros((*few.shape[:2], len(z)))
        A[..., size:] = few[..., :5]
        A[..., :size] = few[..., [13, 14, 11, 12]] @ by_arm
        return eliminate(A, few[..., 5:11], few[..., -1])


def measurements(drifts: Sequence[Drift], arm: Arm, settings: DriftSettings) -> DriftMeasurements:
    """Return the measurements of drifts."""
    return DriftMeasurements(drifts, pose_deviations(drifts, settings, np.ones(len(drifts))), arm.n)
