"""Trajectories as clients request them, checked for form and size before any other work.

A link holds 32 segments of a path and receives up to 12 with each command, so a path of many
points has at most some 50 per second. MAX_POINTS is thus 200 s of the densest path that links can
follow at length, or an hour with a point every 0.36 s. It also bounds the time that a goal takes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from reprlib import repr as short
from typing import Any

import numpy as np

from fss_arm_driver.arm.move import MAX_DURATION
from fss_arm_driver.scale import MAX_MAGNITUDE
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, joint_names
from fss_arm_model.units import SECOND

MAX_POINTS = 10_000


class Code(IntEnum):
    """Result codes of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class TrajectoryError(ValueError):
    """Error of a trajectory that is rejected, or ends before its goal: a code, and the reason."""

    def __init__(self, code: Code, words: str) -> None:
        super().__init__(words)
        self.code = code


@dataclass(frozen=True)
class Request:
    """A requested trajectory, joints in the arm's order."""

    stamp: int  # time that `times` count from [ns]; 0: as soon as possible
    times: Floats  # (m,) ascending [s]
    q: Floats  # (m, n) [rad]
    qd: Floats  # (m, n) [rad/s], NaN where it was not given


def parse_request(arm: Arm, message: Any) -> Request:
    """Read a trajectory_msgs/JointTrajectory.

    Raises:
        TrajectoryError: it breaks a rule of joint_trajectory_controller, or has over MAX_POINTS.
    """
    order = _joint_order(message.joint_names, joint_names(arm.n))
    points = message.points
    if not 1 <= len(points) <= MAX_POINTS:
        raise _invalid("points", f"{len(points)} elements", f"1 to {MAX_POINTS}", "has")
    stamp = message.header.stamp
    if stamp.sec < 0 or stamp.nanosec >= SECOND:
        raise _invalid("header.stamp", _format_time(stamp), "a time from 1970 on")
    times = _times(points)
    q, qd = _rows(points, "positions", order), _rows(points, "velocities", order, optional=True)
    _rows(points, "accelerations", order, optional=True)  # checked, but not used
    _reject_efforts(points)
    if (fastest := np.abs(np.nan_to_num(qd[-1])).max()) > np.finfo(np.float32).eps:
        raise _invalid("velocities of the last point", f"up to {fastest:g} rad/s", "0", "are")
    qd[-1] = np.where(np.isnan(qd[-1]), np.nan, 0.0)  # without a planner's rounding errors
    return Request(stamp.sec * SECOND + stamp.nanosec, times, q, qd)


def reject_unsupported_fields(message: Any) -> None:
    """Reject a FollowJointTrajectory goal with fields that an arm of revolute joints lacks.

    Raises:
        TrajectoryError: one is filled.
    """
    several = message.multi_dof_trajectory
    for field, values in (
        ("multi_dof_trajectory.joint_names", several.joint_names),
        ("multi_dof_trajectory.points", several.points),
        ("component_path_tolerance", message.component_path_tolerance),
        ("component_goal_tolerance", message.component_goal_tolerance),
    ):
        if len(values):
            raise _invalid(field, f"{len(values)} elements", "none", "has")


def _joint_order(names: Sequence[str], joints: list[str]) -> list[int]:
    """Return the index of each joint in `names`, which must hold each once.

    Only the first names are compared, as a message may have millions of them.
    """
    expected = f"each of {', '.join(joints)} once"
    if unknown := [name for name in names[: len(joints)] if name not in joints]:
        raise _invalid("joint_names", short(unknown[0]), expected, "has", Code.INVALID_JOINTS)
    if sorted(names[: len(joints) + 1]) != sorted(joints):
        given = ", ".join(names) if len(names) <= len(joints) else f"{len(names)} names"
        raise _invalid("joint_names", given or "empty", expected, "is", Code.INVALID_JOINTS)
    return [names.index(joint) for joint in joints]


def _times(points: Sequence[Any]) -> Floats:
    given = [point.time_from_start for point in points]
    for k, time in enumerate(given):
        if time.nanosec >= SECOND or not 0 <= time.sec + time.nanosec / SECOND <= MAX_DURATION:
            what = f"time_from_start of point {k}"
            raise _invalid(what, _format_time(time), f"0 to {MAX_DURATION:.0f} s")
    times = np.array([time.sec * SECOND + time.nanosec for time in given]) / SECOND
    if late := np.flatnonzero(np.diff(times) <= 0.0).tolist():
        k = late[0] + 1
        raise _invalid(
            f"time_from_start of point {k}",
            _format_time(given[k]),
            f"more than the {_format_time(given[k - 1])} of the point before",
        )
    return times


def _format_time(time: Any) -> str:
    return f"{time.sec} s and {time.nanosec} ns" if time.nanosec else f"{time.sec} s"


def _rows(points: Sequence[Any], field: str, order: list[int], optional: bool = False) -> Floats:
    """Return a field of all points, (m, n) in the arm's order; NaN where it is not given."""
    rows = [getattr(point, field) for point in points]
    for k, row in enumerate(rows):
        if len(row) != len(order) and not (optional and not len(row)):
            what = f"{field} of point {k}"
            raise _invalid(what, f"{len(row)} numbers", str(len(order)), "has")
    found = np.full((len(rows), len(order)), np.nan)
    given = [k for k, row in enumerate(rows) if len(row)]
    if given:
        values = np.array([rows[k] for k in given])
        if wrong := np.argwhere(~(np.abs(values) <= MAX_MAGNITUDE)).tolist():
            k, i = wrong[0]
            raise _invalid(
                f"{field} of point {given[k]}",
                f"{values[k, i]:g} for joint_{order.index(i) + 1}",
                f"finite numbers of at most {MAX_MAGNITUDE:g} in size",
                "has",
            )
        found[given] = values[:, order]
    return found


def _reject_efforts(points: Sequence[Any]) -> None:
    for k, point in enumerate(points):
        if count := len(point.effort):
            raise _invalid(f"effort of point {k}", f"{count} numbers", "none", "has")


def _invalid(
    what: str, value: str, expected: str, verb: str = "is", code: Code = Code.INVALID_GOAL
) -> TrajectoryError:
    return TrajectoryError(code, f"{what} {verb} {value}, expected {expected}")
