"""Goals of `arm/execute` as plans, plans as goals of the arm's node, and the bounds of both."""

import io
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.duration import Duration
from trajectory_msgs.msg import JointTrajectoryPoint

from fss_arm_model.arrays import Floats
from fss_arm_model.description import joint_names
from fss_arm_motion import plan_command
from fss_arm_motion.plan import Plan, PlanError, Start
from fss_arm_motion.plan_file import plan_from_file
from fss_arm_msgs.action import ExecuteMotion
from fss_arm_msgs.msg import MotionReport
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import to_time

MAX_WORDS, MAX_CHARACTERS = 1000, 10_000  # of a goal of `arm/execute`
MAX_POINTS, MAX_DURATION = 10_000, 3600.0  # of a path that the arm's node accepts; [s]


def oversized(goal: ExecuteMotion.Goal) -> str:
    """Name the field of a goal that is too large; empty: none is."""
    if len(goal.arguments) > MAX_WORDS:
        return f"arguments has {len(goal.arguments)} words, expected at most {MAX_WORDS}"
    words = ("arguments", "".join(goal.arguments)), ("kind", goal.kind), ("file", goal.file)
    for field, text in words:
        if len(text) > MAX_CHARACTERS:
            return f"{field} has {len(text)} characters, expected at most {MAX_CHARACTERS}"
    return ""


def too_long(plan: Plan) -> str:
    """Name the bound of the arm's node that a plan exceeds; empty: none."""
    if not plan.duration <= MAX_DURATION:
        return f"the plan takes {plan.duration:g} s, expected at most {MAX_DURATION:.0f}"
    if len(plan.times) > MAX_POINTS:
        return f"the plan has {len(plan.times)} points, expected at most {MAX_POINTS}"
    return ""


def options_of(kind: str, arguments: Sequence[str]) -> tuple[Any, Any]:
    """Return the kind of plan that a command line asks for, and its settings.

    Raises:
        PlanError: the line is wrong.
    """
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            options = plan_command.parser().parse_args([kind, *arguments])
    except SystemExit:
        raise PlanError(said.getvalue().strip() or "--help is for the command line") from None
    return plan_command.request_of(options)


def planning(goal: ExecuteMotion.Goal, start: Start, tolerance: float) -> Callable[[], Plan]:
    """Return the function that plans the motion of a goal; it raises ValueError and OSError.

    Args:
        goal: has either a kind of plan or a file.
        start: present state.
        tolerance: maximum distance of a joint from the start of a file's plan [rad].

    Raises:
        PlanError: the goal is wrong.
    """
    if bool(goal.kind) == bool(goal.file):
        raise PlanError("the goal must have either a kind or a file")
    make: Callable[[], Plan]
    if goal.file:
        make = partial(plan_from_file, Path(goal.file), start, tolerance)
    else:
        kind, settings = options_of(goal.kind, goal.arguments)
        make = partial(kind.plan, start, settings)

    def plan() -> Plan:
        plan = make()
        if why := too_long(plan):
            raise PlanError(why)
        return plan

    return plan


def trajectory(plan: Plan, begin: int) -> FollowJointTrajectory.Goal:
    """Return a plan as a goal of the arm's node that starts at time `begin` [ns]."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.header.stamp = to_time(begin)
    goal.trajectory.joint_names = joint_names(plan.q.shape[1])
    goal.trajectory.points = [
        JointTrajectoryPoint(
            positions=q.tolist(),
            velocities=qd.tolist(),
            time_from_start=Duration(seconds=float(t)).to_msg(),
        )
        for t, q, qd in zip(plan.times, plan.q, plan.qd, strict=True)
    ]
    return goal


def motion_report(
    plan: Plan,
    arguments: Sequence[str],
    calibrated: Calibrated,
    start_time: int,
    measured: tuple[Floats, Floats] | None,
) -> MotionReport:
    """Return the predicted and measured motion of the base.

    Args:
        plan: the executed plan.
        arguments: of its goal.
        calibrated: the arm.
        start_time: start of the motion [ns].
        measured: change and largest deviation of the base's pose, (3,) each; None: unknown.
    """
    base, unknown = plan.prediction, np.full(3, np.nan)
    moved, excursion = measured or (unknown, unknown)
    report = MotionReport(
        kind=plan.kind,
        arguments=list(arguments),
        arm=calibrated.arm.name,
        duration=plan.duration,
        predicted=base.pose[-1] - base.pose[0],
        predicted_deviation=base.deviation[-1] if calibrated.covariance.any() else unknown,
        measured=moved,
        predicted_excursion=base.excursion,
        measured_excursion=excursion[2],
    )
    report.header.stamp, report.header.frame_id = to_time(start_time), "world"
    return report
