"""How far joints may be from a trajectory, on its way and at its end."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from fss_arm_driver.arm.trajectory import Code, TrajectoryError

ERASED = -1.0  # as a tolerance in a goal: none


@dataclass(frozen=True)
class Tolerance:
    """Of one joint; 0: none."""

    position: float = 0.0  # [rad]
    velocity: float = 0.0  # [rad/s]

    def violated(self, error: float, rate: float) -> str:
        """What errors of position [rad] and rate [rad/s] exceed, in words."""
        if 0.0 < self.position < abs(error):
            return f"is off by {abs(error):.4f} rad, at most {self.position:g}"
        if 0.0 < self.velocity < abs(rate):
            return f"is off by {abs(rate):.4f} rad/s, at most {self.velocity:g}"
        return ""


@dataclass(frozen=True)
class Tolerances:
    """Of all joints, (n) each, and the time to reach the goal after the end [s]; 0: any."""

    path: tuple[Tolerance, ...]
    goal: tuple[Tolerance, ...]
    goal_time: float

    def of_goal(self, goal: Any) -> "Tolerances":
        """These, with what a FollowJointTrajectory goal says instead.

        Raises:
            TrajectoryError: a joint is unknown, or a value is negative and not ERASED.
        """
        time = goal.goal_time_tolerance
        return Tolerances(
            _given(goal.path_tolerance, self.path, "path_tolerance"),
            _given(goal.goal_tolerance, self.goal, "goal_tolerance"),
            _chosen(time.sec + 1e-9 * time.nanosec, self.goal_time, "goal_time_tolerance"),
        )


def _given(
    given: Iterable[Any], default: tuple[Tolerance, ...], field: str
) -> tuple[Tolerance, ...]:
    joints = {f"joint_{i}": i - 1 for i in range(1, len(default) + 1)}
    found = list(default)
    for one in given:
        if (i := joints.get(one.name)) is None:
            words = f"{field} names {one.name!r}, expected {', '.join(joints)}"
            raise TrajectoryError(Code.INVALID_JOINTS, words)
        what = f"{field} of {one.name}"
        found[i] = replace(
            found[i],
            position=_chosen(one.position, default[i].position, what),
            velocity=_chosen(one.velocity, default[i].velocity, what),
        )
        _chosen(one.acceleration, 0.0, what)  # nothing measures it
    return tuple(found)


def _chosen(value: float, default: float, what: str) -> float:
    """A goal's value: 0 means the default, -1 none."""
    if value == ERASED:
        return 0.0
    if not isfinite(value) or value < 0.0:
        raise TrajectoryError(Code.INVALID_GOAL, f"{what} is {value}, expected -1, 0 or more")
    return value or default
