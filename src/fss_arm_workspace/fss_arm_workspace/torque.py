"""Joint torques that a path takes, on a fixed and on a floating base.

A path q(s) is run through in the time T by s(t) = L (10 r^3 - 15 r^4 + 6 r^5), r = t / T, which
begins and ends at rest without jerks. On an air-bearing table no gravity acts, so that

    tau = H q'' (ds/dt)^2 + H q' d2s/dt2 + h(q, q') (ds/dt)^2

scales with 1 / T^2 as a whole: the shortest time within a torque limit follows without a search.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline

from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inverse_dynamics
from fss_arm_workspace.regions.arcs import Floats

PEAK = 1.8  # of the links' actuators [N m]


@dataclass(frozen=True)
class Effort:
    """The torques along a path that is run through in `duration`."""

    duration: float  # [s]
    time: Floats  # (m,) [s]
    torque: Floats  # (m, n) of the joints [N m]
    reaction: Floats  # (m, 3) that must hold the base: 0 on a floating one [N, N, N m]

    @property
    def peak(self) -> float:
        """The largest torque of any joint [N m]."""
        return float(np.abs(self.torque).max())

    def within(self, limit: float = PEAK) -> "Effort":
        """The same path, run through as fast as the torque limit [N m] allows."""
        slower = np.sqrt(self.peak / limit)
        share = 1.0 / slower**2
        return Effort(
            self.duration * slower, self.time * slower, self.torque * share, self.reaction * share
        )


def effort_along(
    arm: Arm,
    length: npt.ArrayLike,
    states: npt.ArrayLike,
    rates: npt.ArrayLike,
    duration: float,
    *,
    count: int = 201,
) -> Effort:
    """The torques along a path.

    Args:
        arm: the arm.
        length: ascending, (k,) [m].
        states: the base's pose and the joint readings there, (k, 3 + n).
        rates: their derivatives by the length, (k, 3 + n).
        duration: T, to run through all of it [s].
        count: moments at which to compute them.

    Raises:
        ValueError: shapes do not fit, or a number is not finite.
    """
    s = np.asarray(length, dtype=float)
    path = CubicHermiteSpline(s, states, rates)
    r = np.linspace(0.0, 1.0, count)
    whole = s[-1] - s[0]
    at = s[0] + whole * (10.0 * r**3 - 15.0 * r**4 + 6.0 * r**5)
    speed = (whole / duration * (30.0 * r**2 - 60.0 * r**3 + 30.0 * r**4))[:, None]
    gain = (whole / duration**2 * (60.0 * r - 180.0 * r**2 + 120.0 * r**3))[:, None]
    slope, bend = path(at, 1), path(at, 2)
    tau = inverse_dynamics(arm.vector(), path(at), slope * speed, slope * gain + bend * speed**2)
    return Effort(duration, r * duration, tau[:, 3:], tau[:, :3])
