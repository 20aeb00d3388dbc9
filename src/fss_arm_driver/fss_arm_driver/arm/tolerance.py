"""Tolerances of joints along a trajectory and at its goal."""

from collections.abc import Sequence
from dataclasses import dataclass
from reprlib import repr as short
from typing import Any

from fss_arm_driver.arm.move import MAX_DURATION
from fss_arm_driver.arm.request import Code, TrajectoryError
from fss_arm_driver.scale import MAX_MAGNITUDE
from fss_arm_model.description import joint_names
from fss_arm_model.units import SECOND

NO_TOLERANCE = -1.0  # in a goal: none; 0 in a goal: the default
#: Smallest tolerance above 0, in its unit; the default encoder resolves 2.6e-5 rad.
MIN_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Tolerance:
    """Tolerance of one joint; 0: none, unlike in a goal (`_chosen`)."""

    position: float = 0.0  # [rad]
    velocity: float = 0.0  # [rad/s]

    def violation(self, error: float, rate_error: float) -> str:
        """Describe which tolerance the errors [rad], [rad/s] exceed; empty: none."""
        if 0.0 < self.position < abs(error):
            return f"is off by {abs(error):.3g} rad, at most {self.position:g}"
        if 0.0 < self.velocity < abs(rate_error):
            return f"is off by {abs(rate_error):.3g} rad/s, at most {self.velocity:g}"
        return ""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of all joints."""

    path: tuple[Tolerance, ...]  # (n,)
    goal: tuple[Tolerance, ...]  # (n,)
    goal_time: float  # after the end, in which the goal must be reached [s]; 0: no limit

    def with_goal(self, goal: Any) -> "Tolerances":
        """Return these, with the values that a FollowJointTrajectory goal gives instead.

        Raises:
            TrajectoryError: a joint is unknown or named twice, or a value is out of range.
        """
        time = goal.goal_time_tolerance
        if time.nanosec >= SECOND:
            words = f"goal_time_tolerance has {time.nanosec} ns, expected less than {SECOND}"
            raise TrajectoryError(Code.INVALID_GOAL, words)
        seconds = time.sec + 1e-9 * time.nanosec
        return Tolerances(
            _merged(goal.path_tolerance, self.path, "path_tolerance"),
            _merged(goal.goal_tolerance, self.goal, "goal_tolerance"),
            _chosen(seconds, self.goal_time, "goal_time_tolerance", "s", MAX_DURATION),
        )


def _merged(
    given: Sequence[Any], default: tuple[Tolerance, ...], field: str
) -> tuple[Tolerance, ...]:
    """Return the default of each joint, or what `given` has instead."""
    if len(given) > len(default):
        words = f"{field} has {len(given)} elements, expected at most {len(default)}, one per joint"
        raise TrajectoryError(Code.INVALID_GOAL, words)
    found = dict(zip(joint_names(len(default)), default, strict=True))
    names = [one.name for one in given]
    for one in given:
        if one.name not in found or names.count(one.name) > 1:
            expected = f"some of {', '.join(found)}, each at most once"
            words = f"{field} names {short(one.name)}, expected {expected}"
            raise TrajectoryError(Code.INVALID_JOINTS, words)
        what, usual = f"{field} of {one.name}", found[one.name]
        found[one.name] = Tolerance(
            _chosen(one.position, usual.position, f"position in {what}", "rad"),
            _chosen(one.velocity, usual.velocity, f"velocity in {what}", "rad/s"),
        )
        # Checked, but without effect (docs/reference/commands.md): accelerations are not measured.
        _chosen(one.acceleration, 0.0, f"acceleration in {what}", "rad/s^2")
    return tuple(found.values())


def _chosen(
    value: float, default: float, what: str, unit: str, greatest: float = MAX_MAGNITUDE
) -> float:
    """Return the tolerance that a goal selects, 0: none. In a goal 0 is the default, -1 none."""
    if value == NO_TOLERANCE:
        return 0.0
    if value and not MIN_TOLERANCE <= value <= greatest:
        words = f"expected -1, 0, or {MIN_TOLERANCE:g} to {greatest:g}"
        raise TrajectoryError(Code.INVALID_GOAL, f"{what} is {value:g} {unit}, {words}")
    return value or default
