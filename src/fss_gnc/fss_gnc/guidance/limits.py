"""Limits of speed and acceleration of the base: their use by a path, and paths within them."""

from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_gnc.guidance.settings import GuidanceSettings
from fss_gnc.reference import Body, Path, Reference

MIN_DURATION = 1.0  # of a motion [s]


def braking(settings: GuidanceSettings, base: Body, start: float = 0.0) -> Path:
    """Return a path that brings the base to rest within the limits, from the time `start` [s]."""
    v, omega = float(np.hypot(*base.twist[:2])), abs(float(base.twist[2]))
    duration = 1.5 * max(v / settings.acceleration, omega / settings.turn_acceleration)
    duration = max(MIN_DURATION, duration)
    initial = Reference(base.pose, base.twist, np.zeros(3))
    return Path.between(initial, base.pose + 0.5 * duration * base.twist, start, duration)


class LimitUse(NamedTuple):
    """Largest share of a limit that a path takes, and its description."""

    share: float
    description: str


def limit_use(
    settings: GuidanceSettings, path: Path, initial_twist: Floats | None = None
) -> LimitUse:
    """Return the largest share of a limit that a path takes.

    Args:
        settings: the limits.
        path: of the base.
        initial_twist: (3,) twist that the base has already, allowed regardless of the limits.
    """
    s, t = settings, np.zeros(3) if initial_twist is None else initial_twist
    times, states = path.sample_segments(float(path.times[0]))
    speed, acceleration = np.hypot(*states[:, 1, :2].T), np.hypot(*states[:, 2, :2].T)
    turn_rate, turn_acceleration = np.abs(states[:, 1:, 2]).T
    rows = (
        ("speed", "m/s", speed, max(s.speed, 1.05 * float(np.hypot(*t[:2])))),
        ("turn rate", "rad/s", turn_rate, max(s.turn_rate, 1.05 * abs(float(t[2])))),
        ("acceleration", "m/s^2", acceleration, s.acceleration),
        ("angular acceleration", "rad/s^2", turn_acceleration, s.turn_acceleration),
    )
    shares = [float(values.max()) / limit for _, _, values, limit in rows]
    quantity, unit, values, limit = rows[int(np.argmax(shares))]
    k = int(values.argmax())
    description = (
        f"the path's {quantity} after {times[k]:.1f} s is {values[k]:.4f} {unit}, expected at most "
        f"{limit:g} {unit}"
    )
    return LimitUse(max(shares), description)


def min_duration(settings: GuidanceSettings, start: Reference, goal: Floats) -> float:
    """Return the least time within the limits from a state to a pose at rest [s]."""

    def is_allowed(duration: float) -> bool:
        path = Path.between(start, goal, 0.0, duration)
        return limit_use(settings, path, start.twist).share <= 1.0

    upper = MIN_DURATION
    while not is_allowed(upper):
        upper *= 2.0
    lower = MIN_DURATION if upper == MIN_DURATION else 0.5 * upper
    while upper - lower > 0.01 * upper:
        middle = 0.5 * (lower + upper)
        lower, upper = (lower, middle) if is_allowed(middle) else (middle, upper)
    return upper
