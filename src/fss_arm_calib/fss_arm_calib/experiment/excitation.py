"""Excitation of the drives' own parameters: each joint alone moves back and forth.

Fast moves show viscous friction and the torque's scale, slow moves the Stribeck curve. Moves in
both directions separate friction from the zero of the torque sensor. Two postures vary the load by
the other links. All moves have different durations, so that slow telemetry samples the swinging of
the links at different phases.
"""

import numpy as np

from fss_arm_calib.experiment.planned import NoManeuver, Planned
from fss_arm_calib.experiment.settings import JOINT
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.straight_moves import torque_limited_duration

AMPLITUDES = (1.2, 0.8, 1.0, 0.3, 0.12, 0.06)  # amplitudes of the moves [rad]
MIN_DURATIONS = (3.0, 2.4, 4.0, 3.0, 3.0, 3.0)  # least duration of each move [s]
POSTURE = (0.2, 0.7, -1.0, 0.9)  # joint angles of a posture, cyclic; negated for the other [rad]
DURATION_VARIATION = 0.1  # largest relative variation of the durations


def plan_excitation(
    arm: Arm, repeats: int = 1, settings: GuardSettings | None = None, seed: int = 0
) -> list[Planned]:
    """Plan one maneuver of back-and-forth moves for each posture and joint, `repeats` times.

    For the guard, the base is at the table's centre. The seed is that of the durations.

    Raises:
        NoManeuver: a joint cannot move even with reduced amplitudes.
    """
    guard, rng = Guard(arm, settings), np.random.default_rng(seed)
    low, high = (0.95 * np.array([getattr(k, q) for k in arm.links]) for q in ("q_min", "q_max"))
    bends = np.resize(POSTURE, arm.n)
    plan = []
    for posture in [bends, -bends] * repeats:
        begin = np.clip(posture, low, high)
        plan += [_plan_joint(guard, begin, j, (low[j], high[j]), rng) for j in range(arm.n)]
    return plan


def _plan_joint(
    guard: Guard, begin: Floats, j: int, span: tuple[float, float], rng: np.random.Generator
) -> Planned:
    """Plan the largest moves of a joint that keep the arm clear; first try its farther limit."""
    sides = sorted((span[0] - begin[j], span[1] - begin[j]), key=abs, reverse=True)
    for share in (1.0, 0.5, 0.25):
        for side in sides:
            ways = np.sign(side) * np.minimum(share * np.array(AMPLITUDES), abs(side))
            waypoints = np.tile(begin, (2 * len(ways) + 1, 1))
            waypoints[1::2, j] += ways
            away = np.tile(begin, (len(ways), 1))
            away[:, j] += ways
            least = np.maximum(torque_limited_duration(guard.arm, begin, away), MIN_DURATIONS)
            varied = rng.uniform(1.0, 1.0 + DURATION_VARIATION, 2 * len(ways))
            durations = np.repeat(least, 2) * varied
            planned = Planned(JOINT, waypoints, durations)
            law, edges = planned.law()
            try:
                guard.check_posture(begin, base=np.zeros(3))
                guard.check_path(edges, *law(edges), base=np.zeros(3))
            except GuardError:
                continue
            return planned
    raise NoManeuver(f"joint {j + 1} has no room to move alone from {np.round(begin, 2).tolist()}")
