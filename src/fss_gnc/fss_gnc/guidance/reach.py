"""The reach: joint rates that move the end effector to the fixture while the base floats.

The desired twist of the end effector leads to the point where the fixture will be, as soon as the
speed limit allows. Near the fixture it follows the fixture. While momentum is constant, joint rates
add the twist J* q' to the drift that the momentum causes (momentum.py). Damped least squares give

    q' = J*' (J* J*' + lambda^2 1)^-1 W (v_wanted - v_drift) + N (q_middle - q) / T

The rows of J* are weighted by W, because position matters more than heading. The null space,
N = 1 - J*' (..)^-1 J*, is used to keep the joints away from their limits.
"""

from math import pi

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import generalized_jacobian, momentum, system_com
from fss_arm_model.planar import wrap
from fss_gnc.guidance.mission_settings import MissionSettings

Floats = npt.NDArray[np.float64]

WEIGHT = np.array([1.0, 1.0, 0.1])  # of the twist's rows [1, 1, m]
DAMPING = 1e-3  # lambda^2 [m^2]
MEETINGS = np.linspace(1.0, 6.0, 26)  # possible times until the end effector meets the fixture [s]
MOST_TURN = 0.2  # largest turn rate of the end effector [rad/s]
CENTRING = 10.0  # T [s]
AHEAD = 0.3  # time within which a joint must not reach its limit [s]


class Reach:
    """Controller of the reach, by the damped generalized Jacobian."""

    def __init__(self, arm: Arm, settings: MissionSettings) -> None:
        self.p, self.settings = arm.vector(), settings
        self.lowest = np.array([link.q_min for link in arm.links])
        self.highest = np.array([link.q_max for link in arm.links])
        self.momentum = np.zeros(3)

    def begin(self, q: Floats, qd: Floats) -> None:
        """Store the momentum of state q and rate qd, (3 + n,) each; the valves must be closed."""
        self.momentum = momentum(self.p, q, qd)

    def rates(self, q: Floats, state: Floats) -> Floats:
        """Return the rates of the joints now, (n,) [rad/s].

        Args:
            q: (3 + n,) state of base and arm.
            state: (2, 3) pose and twist of the target.
        """
        wanted = self._wanted(tip_pose(self.p, q), state)
        J = WEIGHT[:, None] * generalized_jacobian(self.p, q)
        twist = WEIGHT * (wanted - self._drift(q))
        inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING * np.eye(3))
        centring = (0.5 * (self.lowest + self.highest) - q[3:]) / CENTRING
        rates = inverse @ twist + centring - inverse @ (J @ centring)
        return limited(rates, q[3:], self.lowest, self.highest, self.settings.joint_rate)

    def _wanted(self, tip: Floats, state: Floats) -> Floats:
        """Return the end effector's twist that meets the fixture as soon as its speed allows."""
        ahead = fixtures(state, self.settings, MEETINGS)
        apart = ahead[:, 0] + 1j * ahead[:, 1] - complex(*tip[:2])
        in_time = np.abs(apart) <= self.settings.reach_speed * MEETINGS
        k = int(np.argmax(in_time)) if in_time.any() else len(MEETINGS) - 1
        v = shortened(complex(apart[k]) / MEETINGS[k], 2.0 * self.settings.reach_speed)
        turn = float(wrap(ahead[k, 2] - tip[2])) / MEETINGS[k]
        return np.array([v.real, v.imag, min(max(turn, -MOST_TURN), MOST_TURN)])

    def _drift(self, q: Floats) -> Floats:
        """Return the twist of the end effector for joints at rest and the stored momentum."""
        H, c = inertia_matrix(self.p, q), complex(*system_com(self.p, q))
        x, y, L = self.momentum.tolist()
        moment = H[2, 2] - H[0, 0] * abs(c - complex(*q[:2])) ** 2
        omega = L / moment
        tip = complex(*tip_pose(self.p, q)[:2])
        v = complex(x, y) / H[0, 0] + 1j * omega * (tip - c)
        return np.array([v.real, v.imag, omega])


def fixtures(state: Floats, settings: MissionSettings, ahead: Floats) -> Floats:
    """Return poses (k, 3) of an end effector at the fixture, times ahead [s], at constant twist."""
    x, y, outward = settings.target_fixture
    pose = state[0] + ahead[:, None] * state[1]
    at = pose[:, 0] + 1j * pose[:, 1] + complex(x, y) * np.exp(1j * pose[:, 2])
    return np.stack([at.real, at.imag, pose[:, 2] + outward + pi], axis=1)


def limited(rates: Floats, q_m: Floats, lowest: Floats, highest: Floats, most: float) -> Floats:
    """Return the rates, scaled down together to `most`, and limited near the ends of the ranges."""
    rates = rates * min(1.0, most / max(float(np.abs(rates).max()), 1e-9))
    least, most_ = (np.minimum(lowest - q_m, 0.0) / AHEAD, np.maximum(highest - q_m, 0.0) / AHEAD)
    return np.clip(rates, least, most_)


def shortened(vector: complex, most: float) -> complex:
    """Return the vector, shortened to the length `most` if it is longer."""
    return vector if abs(vector) <= most else vector * (most / abs(vector))
