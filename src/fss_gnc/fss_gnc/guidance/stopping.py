"""Braking of base and joints within the limits of valves, joints' torques and grip.

Joint accelerations q'' accelerate the base by -H_b^-1 (H_bm q'' + h_b) (H, h: dynamics.py). The
grip must transmit what then accelerates the held body: a force at the tip, and a torque.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.dynamics import inertia_matrix, inverse_dynamics
from fss_arm_model.free_floating import free_torques
from fss_arm_model.held import Target, payload_state
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import momentum
from fss_gnc.guidance.approach import valve_load
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.reference import Path

MIN_DURATION, MAX_DURATION = 0.5, 120.0  # bounds of the time to come to rest [s]
TIME_STEP = 1e-4  # of a finite difference [s]


class Grip(NamedTuple):
    """A held body, and the load that its grip may transmit."""

    body: Target
    place: Floats  # (3,) in the last link's frame (held.py)
    force: float  # [N]
    torque: float  # [N m]

    def holds(self, p: Floats, q: Floats, qd: Floats, qdd_m: Floats) -> bool:
        """Return True if the load is within these limits."""
        force, torque = grip_load(p, q, qd, qdd_m, self.body, self.place)
        return force <= self.force and torque <= self.torque


def grip_of(settings: MissionSettings, body: Target, place: Floats) -> Grip:
    """Return the grip of a held body, with the share of its limits that motions may use."""
    share = settings.torque_share
    force, torque = share * settings.grip_force, share * settings.grip_torque
    return Grip(body, place, force or np.inf, torque or np.inf)


def grip_load(
    p: Floats, q: Floats, qd: Floats, qdd_m: Floats, body: Target, place: Floats
) -> tuple[float, float]:
    """Return force [N] and torque about the tip [N m] that a grip transmits, the base floating.

    Args:
        p: (8 + 6 n,) Arm.vector(), with the held body.
        q: (3 + n,) state.
        qd: (3 + n,) rate of the state.
        qdd_m: (n,) accelerations of the joints.
        body: the held body.
        place: (3,) its pose in the last link's frame.
    """
    qdd = np.concatenate([np.zeros(3), qdd_m])
    qdd[:3] = -np.linalg.solve(inertia_matrix(p, q)[:3, :3], inverse_dynamics(p, q, qd, qdd)[:3])
    pose, twist = payload_state(p, q, qd, place)
    later = payload_state(p, q + TIME_STEP * qd, qd + TIME_STEP * qdd, place)[1]
    ax, ay, turn = ((later - twist) / TIME_STEP).tolist()
    fx, fy = body.mass * ax, body.mass * ay
    x, y = (pose - tip_pose(p, q))[:2].tolist()
    return float(np.hypot(fx, fy)), abs(body.inertia * turn + x * fy - y * fx)


def braking(
    p: Floats,
    q: Floats,
    qd: Floats,
    settings: MissionSettings,
    start: float,
    final_twist: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Path:
    """Return a path of the base from its twist to another, joints held, as short as valves allow.

    Args:
        p: (8 + 6 n,) Arm.vector(), with the held target.
        q: (3 + n,) state.
        qd: (3 + n,) rate of the state.
        settings: of the missions.
        start: time of the start [s].
        final_twist: twist at the end [m/s, m/s, rad/s].
    """
    end, zero = np.asarray(final_twist, dtype=float), np.zeros(q.size - 3)
    duration, twist = MIN_DURATION, np.concatenate([qd[:3], zero])
    while duration < MAX_DURATION:
        change = np.concatenate([(end - qd[:3]) / duration, zero])
        wrench = inverse_dynamics(p, q, twist, change)[:3]
        if valve_load(wrench, q[2], settings) <= settings.authority:
            break
        duration *= 1.25
    pose = q[:3] + 0.5 * duration * (qd[:3] + end)
    knots = np.array([[q[:3], qd[:3]], [pose, end]])
    return Path(np.array([start, start + duration]), knots)


def joint_stop_time(
    p: Floats, q: Floats, qd: Floats, torques: Floats, grip: Grip | None = None
) -> float:
    """Return the time in which the joints stop within limits, the base floating [s].

    Args:
        p: (8 + 6 n,) Arm.vector(), with the held body.
        q: (3 + n,) state.
        qd: (3 + n,) rate of the state.
        torques: (n,) largest torques of the joints [N m].
        grip: the grip and its limits; None: no limits.
    """
    duration, L = MIN_DURATION, momentum(p, q, qd)[2]
    while duration < MAX_DURATION:
        braked = -qd[3:] / duration
        torques_needed, _ = free_torques(p, q[3:], qd[3:], braked, L)
        is_held = grip is None or grip.holds(p, q, qd, braked)
        if (np.abs(torques_needed) <= torques).all() and is_held:
            break
        duration *= 1.25
    return duration
