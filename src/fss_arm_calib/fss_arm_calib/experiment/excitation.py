"""Moves that make the drives' own parameters visible: each joint alone, to and fro.

At speed viscous friction and the torque's scale show, near rest Stribeck's curve; both directions
tell friction from the torque sensor's zero. Two postures let the other links' pull differ. No two
moves take the same time, so that slow telemetry meets swinging links at another phase each time.
"""

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.experiment.planned import NoManeuver, Planned, timed
from fss_arm_calib.experiment.settings import JOINT
from fss_arm_model.description import Arm
from fss_arm_motion.guard import Guard, GuardError
from fss_arm_motion.guard_settings import GuardSettings

WAYS = (1.2, 0.8, 1.0, 0.3, 0.12, 0.06)  # [rad]
TIMES = (3.0, 2.4, 4.0, 3.0, 3.0, 3.0)  # of each way [s]
BENDS = (0.2, 0.7, -1.0, 0.9)  # of the joints of a posture, in turn; of the other one negated [rad]
UNEVEN = 0.1  # share by which times differ at most


def excitation(
    arm: Arm, repeats: int = 1, settings: GuardSettings | None = None, seed: int = 0
) -> list[Planned]:
    """For each posture and joint one maneuver of moves to and fro.

    Args:
        arm: whose drives' limits, joints' ranges and clearance are kept to.
        repeats: of all maneuvers.
        settings: of the guard; the base is at the table's centre.
        seed: of the times.

    Raises:
        NoManeuver: a joint cannot move so far, even by less.
    """
    guard, rng = Guard(arm, settings), np.random.default_rng(seed)
    low, high = (0.95 * np.array([getattr(k, q) for k in arm.links]) for q in ("q_min", "q_max"))
    bends = np.resize(BENDS, arm.n)
    plan = []
    for posture in [bends, -bends] * repeats:
        begin = np.clip(posture, low, high)
        plan += [_to_and_fro(guard, begin, j, (low[j], high[j]), rng) for j in range(arm.n)]
    return plan


def _to_and_fro(
    guard: Guard, begin: Floats, j: int, span: tuple[float, float], rng: np.random.Generator
) -> Planned:
    """The longest ways of a joint, towards its farther end if possible, that keep the arm clear."""
    sides = sorted((span[0] - begin[j], span[1] - begin[j]), key=abs, reverse=True)
    for share in (1.0, 0.5, 0.25):
        for side in sides:
            ways = np.sign(side) * np.minimum(share * np.array(WAYS), abs(side))
            waypoints = np.tile(begin, (2 * len(ways) + 1, 1))
            waypoints[1::2, j] += ways
            durations = np.array(
                [
                    time * rng.uniform(1.0, 1.0 + UNEVEN)
                    for way, least in zip(ways, TIMES, strict=True)
                    for time in [_time(guard.arm, begin, j, way, least)] * 2
                ]
            )
            planned = Planned(JOINT, waypoints, durations)
            law, edges = planned.law()
            try:
                guard.check_posture(begin, base=np.zeros(3))
                guard.check_path(edges, *law(edges), base=np.zeros(3))
            except GuardError:
                continue
            return planned
    raise NoManeuver(f"joint {j + 1} has no room to move alone from {np.round(begin, 2).tolist()}")


def _time(arm: Arm, begin: Floats, j: int, way: float, least: float) -> float:
    away = begin.copy()
    away[j] += way
    return max(least, float(timed(arm, begin, away)))
