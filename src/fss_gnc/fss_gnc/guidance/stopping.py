"""Braking of base and joints within the limits of the valves and of the joints' torques."""

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.dynamics import inverse_dynamics
from fss_arm_model.free_floating import free_torques
from fss_arm_model.momentum import momentum
from fss_gnc.guidance.approach import valve_load
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.reference import Path

MIN_DURATION, MAX_DURATION = 0.5, 120.0  # bounds of the time to come to rest [s]


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


def joint_stop_time(p: Floats, q: Floats, qd: Floats, torques: Floats) -> float:
    """Return the time in which the joints stop within torques (n,), the base floating [s]."""
    duration, L = MIN_DURATION, momentum(p, q, qd)[2]
    while duration < MAX_DURATION:
        torques_needed, _ = free_torques(p, q[3:], qd[3:], -qd[3:] / duration, L)
        if (np.abs(torques_needed) <= torques).all():
            break
        duration *= 1.25
    return duration
