"""The reach: joint rates that move the end effector to the fixture while the base floats.

The desired twist of the end effector leads to the point where the fixture will be, as soon as the
speed limit allows. Near the fixture it is the twist of the fixture plus a correction of the pose,
so that the grip hardly changes velocities. While momentum is constant, joint rates add the twist
J* q' to the drift that the momentum causes (momentum.py). Damped least squares give

    q' = J*' (J* J*' + lambda^2 1)^-1 W (v_wanted - v_drift) + N (q_middle - q) / T

The rows of J* are weighted by W, because position matters more than heading. The null space,
N = 1 - J*' (..)^-1 J*, is used to keep the joints away from their limits. All of this is computed
for the time at which the joints will have the commanded rates.
"""

from math import pi

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import generalized_jacobian, momentum, system_com
from fss_arm_model.planar import wrap
from fss_gnc.guidance.mission_settings import MissionSettings

ROW_WEIGHTS = np.array([1.0, 1.0, 0.07])  # of the twist's rows [1, 1, m]
DAMPING = 1e-3  # lambda^2 [m^2]
# Possible times until the end effector meets the fixture [s].
INTERCEPT_TIMES = np.linspace(1.0, 6.0, 101)
MAX_TURN_RATE = 0.2  # largest turn rate of the end effector, or relative to the fixture [rad/s]
FOLLOWING_DISTANCE = 0.05  # from the fixture; within it, the end effector follows the fixture [m]
FOLLOWING_TIMES = 0.5, 2.0  # in which it then corrects position and heading [s]
RESPONSE_TIME = 0.15  # from a state until the joints have the rates commanded for it [s]
CENTERING_TIME = 4.0  # T [s]
LIMIT_LOOKAHEAD = 0.6  # time within which a joint must not reach its limit [s]


class Reach:
    """Controller of the reach, by the damped generalized Jacobian."""

    def __init__(self, arm: Arm, settings: MissionSettings) -> None:
        self.p, self.settings = arm.vector(), settings
        self.q_min = np.array([link.q_min for link in arm.links])
        self.q_max = np.array([link.q_max for link in arm.links])
        self.max_rates = np.array([link.drive.max_velocity for link in arm.links])
        self.momentum = np.zeros(3)

    def set_momentum(self, q: Floats, qd: Floats) -> None:
        """Store the momentum of state q and rate qd, (3 + n,) each; the valves must be closed."""
        self.momentum = momentum(self.p, q, qd)

    def rates(self, q: Floats, qd: Floats, state: Floats) -> Floats:
        """Return the rates of the joints now, (n,) [rad/s].

        Args:
            q: (3 + n,) state of base and arm.
            qd: (3 + n,) its rate.
            state: (2, 3) pose and twist of the target.
        """
        q = q + RESPONSE_TIME * qd
        state = np.array([state[0] + RESPONSE_TIME * state[1], state[1]])
        tip, fixture = tip_pose(self.p, q), fixture_poses(state, self.settings, np.zeros(1))[0]
        distance = float(np.hypot(*(fixture - tip)[:2])) / FOLLOWING_DISTANCE
        nearness = min(max(1.5 - 0.5 * distance, 0.0), 1.0)  # 1: it follows the fixture
        desired = nearness * self._following_twist(tip, fixture, state)
        desired = desired + (1.0 - nearness) * self._meeting_twist(tip, state)
        J = ROW_WEIGHTS[:, None] * generalized_jacobian(self.p, q)
        twist = ROW_WEIGHTS * (desired - self._drift_twist(q))
        inverse = J.T @ np.linalg.inv(J @ J.T + DAMPING * np.eye(3))
        centering = (0.5 * (self.q_min + self.q_max) - q[3:]) / CENTERING_TIME
        rates = inverse @ twist + centering - inverse @ (J @ centering)
        cautious = np.minimum(self.settings.joint_rate, self.max_rates)
        limits = cautious + nearness * (self.max_rates - cautious)
        return limit_rates(rates, q[3:], self.q_min, self.q_max, limits)

    def _following_twist(self, tip: Floats, fixture: Floats, state: Floats) -> Floats:
        """Return the twist that follows the fixture and corrects the pose."""
        error, (x, y, _) = fixture - tip, fixture - state[0]
        vx, vy, spin = state[1].tolist()
        v = complex(error[0], error[1]) / FOLLOWING_TIMES[0]
        v = limit_length(v, self.settings.reach_speed)
        turn = float(wrap(error[2])) / FOLLOWING_TIMES[1]
        turn = min(max(turn, -MAX_TURN_RATE), MAX_TURN_RATE)
        return np.array([vx - spin * y + v.real, vy + spin * x + v.imag, spin + turn])

    def _meeting_twist(self, tip: Floats, state: Floats) -> Floats:
        """Return the twist that meets the fixture as soon as the end effector's speed allows."""
        time = self._meeting_time(tip, state)
        x, y, heading = fixture_poses(state, self.settings, np.array([time]))[0].tolist()
        v = complex(x, y) - complex(*tip[:2])
        v = limit_length(v / time, 2.0 * self.settings.reach_speed)
        turn = float(wrap(heading - tip[2])) / time
        return np.array([v.real, v.imag, min(max(turn, -MAX_TURN_RATE), MAX_TURN_RATE)])

    def _meeting_time(self, tip: Floats, state: Floats) -> float:
        """Return the time until the end effector can meet the fixture [s].

        If the fixture is too fast, it is the time at which the end effector comes closest to it.
        Without a jump from one case to the other, because the joints would oscillate there.
        """
        poses = fixture_poses(state, self.settings, INTERCEPT_TIMES)
        distance = np.abs(poses[:, 0] + 1j * poses[:, 1] - complex(*tip[:2]))
        missing = distance - self.settings.reach_speed * INTERCEPT_TIMES
        k = int(np.argmax(missing <= 0.0)) if missing.min() <= 0.0 else int(np.argmin(missing))
        if k == 0 or missing[k] > 0.0:
            return float(INTERCEPT_TIMES[k])
        return float(np.interp(0.0, -missing[k - 1 : k + 1], INTERCEPT_TIMES[k - 1 : k + 1]))

    def _drift_twist(self, q: Floats) -> Floats:
        """Return the twist of the end effector for joints at rest and the stored momentum."""
        H, c = inertia_matrix(self.p, q), complex(*system_com(self.p, q))
        x, y, L = self.momentum.tolist()
        moment = H[2, 2] - H[0, 0] * abs(c - complex(*q[:2])) ** 2
        omega = L / moment
        tip = complex(*tip_pose(self.p, q)[:2])
        v = complex(x, y) / H[0, 0] + 1j * omega * (tip - c)
        return np.array([v.real, v.imag, omega])


def fixture_poses(state: Floats, settings: MissionSettings, times: Floats) -> Floats:
    """Return poses (k, 3) of a tip at the fixture at future times [s], at constant twist."""
    x, y, outward = settings.target_fixture
    pose = state[0] + times[:, None] * state[1]
    position = pose[:, 0] + 1j * pose[:, 1] + complex(x, y) * np.exp(1j * pose[:, 2])
    return np.stack([position.real, position.imag, pose[:, 2] + outward + pi], axis=1)


def limit_rates(
    rates: Floats, q_m: Floats, q_min: Floats, q_max: Floats, maximum: Floats
) -> Floats:
    """Return the rates, scaled down together to `maximum`, and limited near the joint limits."""
    rates = rates / max(1.0, float((np.abs(rates) / maximum).max()))
    slowest, fastest = (
        np.minimum(q_min - q_m, 0.0) / LIMIT_LOOKAHEAD,
        np.maximum(q_max - q_m, 0.0) / LIMIT_LOOKAHEAD,
    )
    return np.clip(rates, slowest, fastest)


def limit_length(vector: complex, maximum: float) -> complex:
    """Return the vector, shortened to the length `maximum` if it is longer."""
    return vector if abs(vector) <= maximum else vector * (maximum / abs(vector))
