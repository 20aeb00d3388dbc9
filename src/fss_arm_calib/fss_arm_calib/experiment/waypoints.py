"""Waypoints of an experiment, from its postures or its plan of maneuvers."""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fss_arm_calib.experiment.planned import Planned, read_plan
from fss_arm_calib.experiment.postures import default_postures
from fss_arm_calib.experiment.settings import JOINT, ExperimentSettings
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.units import angle_beyond

#: Moves of single joints start at all phases of telemetry with this period, the slowest usual one:
#: samples at equal phases of their ramps would bias torque constants by several percent [s].
TELEMETRY_PERIOD = 0.2
GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)  # its multiples are spread evenly over the period


class Waypoint(NamedTuple):
    """Posture that the arm moves to."""

    q: Floats  # (n) [rad]
    duration: float = 0.0  # duration of the move [s]; 0: as fast as the arm's limits allow
    pause: float = -1.0  # rest at the posture [s]; < 0: until it has been observed
    delay: float = 0.0  # before the move starts [s]


def read_waypoints(settings: ExperimentSettings, arm: Arm) -> list[Waypoint]:
    """Return the stops in order; ValueError: they do not match the arm, or a move is not clear."""
    s = settings
    if s.maneuvers:
        found = maneuver_waypoints(read_plan(s.maneuvers, arm.n), s.pause)
    elif len(s.postures) % arm.n:
        raise ValueError(f"postures has {len(s.postures)} numbers, expected {arm.n} a row")
    elif s.postures:
        found = [Waypoint(q) for q in np.reshape(s.postures, (-1, arm.n))]
    else:
        found = [Waypoint(q) for q in default_postures(arm, s.guarded())]
    check_waypoints(np.array([stop.q for stop in found]).reshape(-1, arm.n), arm, s.guarded())
    return found


def maneuver_waypoints(plan: Sequence[Planned], pause: float) -> list[Waypoint]:
    """Return the stops of maneuvers, with a pause before the first and after each."""
    found = [Waypoint(plan[0].waypoints[0], 0.0, pause)] if plan else []
    for one in plan:
        for q, duration in zip(one.waypoints[1:], one.durations.tolist(), strict=True):
            phase = len(found) * GOLDEN_RATIO % 1.0 if one.kind == JOINT else 0.0
            found.append(Waypoint(q, duration, 0.0, phase * TELEMETRY_PERIOD))
        found[-1] = found[-1]._replace(pause=pause)
    return found


def return_waypoints(waypoints: Sequence[Waypoint]) -> deque[Waypoint]:
    """Return the stops of the way back, from the last to the first with the same durations."""
    found = deque(Waypoint(a.q, b.duration, 0.0) for a, b in pairwise(waypoints))
    found.reverse()
    found[-1] = found[-1]._replace(pause=waypoints[0].pause)
    return found


def check_waypoints(q: Floats, arm: Arm, guarded: GuardSettings) -> None:
    """Raise ValueError if a posture is beyond a limit, or a move between two is not clear."""
    for i, link in enumerate(arm.links):
        outside = (q[:, i] < link.q_min) | (q[:, i] > link.q_max) | ~np.isfinite(q[:, i])
        if outside.any():
            words = angle_beyond(q[outside, i][0], link.q_min, link.q_max)
            raise ValueError(f"postures: joint {i + 1} at {words}")
    guard = Guard(arm, guarded)
    for k in range(len(q)):
        try:
            guard.check_posture(q[k])
            guard.check_path((0.0, 1.0), q[[max(k - 1, 0), k]], np.zeros((2, arm.n)))
        except GuardError as error:
            raise ValueError(f"postures: on the way to posture {k + 1}, {error}") from None
