"""The reach: joint rates that take the end effector onto the fixture while the base floats.

The wanted twist of the end effector meets the fixture where that will be, as soon as its speed
allows, and near to it follows it. With momentum kept, joint rates give the twist J* q' past the
drift that the momentum gives (momentum.py); damped least squares,

    q' = J*' (J* J*' + lambda^2 1)^-1 W (v_wanted - v_drift) + N (q_middle - q) / T

with rows of J* weighted by W, as to be there counts more than to be straight, and what is left
over, N = 1 - J*' (..)^-1 J*, used to keep off the ends of the joints' ranges.
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
MEETINGS = np.linspace(1.0, 6.0, 26)  # when the fixture may be met, from now on [s]
MOST_TURN = 0.2  # of the end effector [rad/s]
CENTRING = 10.0  # T [s]
AHEAD = 0.3  # in which a joint must not come to its end [s]


class Reach:
    """By the generalized Jacobian, damped."""

    def __init__(self, arm: Arm, settings: MissionSettings) -> None:
        self.p, self.settings = arm.vector(), settings
        self.lowest = np.array([link.q_min for link in arm.links])
        self.highest = np.array([link.q_max for link in arm.links])
        self.momentum = np.zeros(3)

    def begin(self, q: Floats, qd: Floats) -> None:
        """Valves are closed: the momentum of the state q at the rate qd, (3 + n,) each, stays."""
        self.momentum = momentum(self.p, q, qd)

    def rates(self, q: Floats, state: Floats) -> Floats:
        """Rates of the joints now, (n,) [rad/s].

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
        """Twist of the end effector: to meet the fixture on its way, as soon as speed allows."""
        ahead = fixtures(state, self.settings, MEETINGS)
        apart = ahead[:, 0] + 1j * ahead[:, 1] - complex(*tip[:2])
        in_time = np.abs(apart) <= self.settings.reach_speed * MEETINGS
        k = int(np.argmax(in_time)) if in_time.any() else len(MEETINGS) - 1
        v = shortened(complex(apart[k]) / MEETINGS[k], 2.0 * self.settings.reach_speed)
        turn = float(wrap(ahead[k, 2] - tip[2])) / MEETINGS[k]
        return np.array([v.real, v.imag, min(max(turn, -MOST_TURN), MOST_TURN)])

    def _drift(self, q: Floats) -> Floats:
        """Twist of the end effector with the joints at rest and momentum as it is."""
        H, c = inertia_matrix(self.p, q), complex(*system_com(self.p, q))
        x, y, L = self.momentum.tolist()
        moment = H[2, 2] - H[0, 0] * abs(c - complex(*q[:2])) ** 2
        omega = L / moment
        tip = complex(*tip_pose(self.p, q)[:2])
        v = complex(x, y) / H[0, 0] + 1j * omega * (tip - c)
        return np.array([v.real, v.imag, omega])


def fixtures(state: Floats, settings: MissionSettings, ahead: Floats) -> Floats:
    """Pose of an end effector that grips the target times ahead [s], (k, 3), drifting evenly."""
    x, y, outward = settings.target_fixture
    pose = state[0] + ahead[:, None] * state[1]
    at = pose[:, 0] + 1j * pose[:, 1] + complex(x, y) * np.exp(1j * pose[:, 2])
    return np.stack([at.real, at.imag, pose[:, 2] + outward + pi], axis=1)


def limited(rates: Floats, q_m: Floats, lowest: Floats, highest: Floats, most: float) -> Floats:
    """Rates no greater than the most, all slowed down alike, and none into the end of a range."""
    rates = rates * min(1.0, most / max(float(np.abs(rates).max()), 1e-9))
    least, most_ = (np.minimum(lowest - q_m, 0.0) / AHEAD, np.maximum(highest - q_m, 0.0) / AHEAD)
    return np.clip(rates, least, most_)


def shortened(vector: complex, most: float) -> complex:
    """The vector, or the one along it that is so long."""
    return vector if abs(vector) <= most else vector * (most / abs(vector))
