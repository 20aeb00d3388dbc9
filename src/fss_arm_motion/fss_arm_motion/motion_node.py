"""Node `motion`: plans motions from the measured state, runs them, and reports on the base."""

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from unique_identifier_msgs.msg import UUID

from fss_arm_model.description_file import described
from fss_arm_model.kernels import Floats
from fss_arm_model.momentum import momentum
from fss_arm_motion.messages import options_of, oversized, too_long, trajectory
from fss_arm_motion.plan import Plan, Start, predicted
from fss_arm_motion.plan_file import parsed
from fss_arm_motion.programs import motion as main
from fss_arm_motion.settings import MotionSettings
from fss_arm_motion.track import Track
from fss_arm_msgs.action import ExecuteMotion
from fss_arm_msgs.msg import DynamicCalibration, KinematicCalibration, MotionReport
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import SECOND, joint_readings, planar_pose, stamp_ns, to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe

CONTROLLER = "arm_controller/follow_joint_trajectory"
HEARTBEAT = 0.5  # of diagnostics: at most 1 s old, whatever the planner's thread does [s]
CALIBRATIONS = {
    "calibration/kinematic": KinematicCalibration,
    "calibration/dynamic": DynamicCalibration,
}


class MotionError(ValueError):
    """A motion cannot start, or ended early; the message gives the reason."""


@dataclass(frozen=True)
class Joints:
    """State of all joints at one time."""

    t: int  # [ns]
    q: Floats  # (n,) [rad]
    qd: Floats  # (n,) [rad/s]


class MotionNode(Node):
    """Executes `arm/execute`: plans, has the links follow, reports on `arm/motion`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("motion", **options)
        self.settings = declare(self, MotionSettings)
        self.calibrated = Calibrated(described(self.settings.arm))
        self.joints = Joints(0, np.zeros(0), np.zeros(0))
        self.base, self.joint_track = Track(angle=2), Track()
        self.moved = 0  # time at which a joint last moved [ns]
        self.busy = False
        self.trajectory_goal: Any = None  # the trajectory that the arm's node follows for us
        self.next_tick: Future = Future()
        self.planner = ThreadPoolExecutor(1, "planner")  # the node must not wait for a plan
        subscribe_sensor(self, JointState, "arm/joint_states", self.on_joints)
        subscribe_sensor(self, Odometry, "base/state", self.on_base)
        for topic, kind in CALIBRATIONS.items():
            subscribe(self, kind, topic, partial(self.on_calibration, topic), LATCHED)
        group = ReentrantCallbackGroup()  # callbacks run while a motion is executed
        self.controller = ActionClient(
            self, FollowJointTrajectory, CONTROLLER, callback_group=group
        )
        self.report = self.create_publisher(MotionReport, "arm/motion", LATCHED)
        self.server = ActionServer(
            self, ExecuteMotion, "arm/execute", self.on_execute, callback_group=group,
            goal_callback=self.on_goal, cancel_callback=self.on_cancel,
        )  # fmt: skip
        self.alive = self.create_publisher(UUID, "arm_controller/alive", 10)
        self.create_timer(0.1, self.tick, clock=timer_clock(self))
        # In real time, as in the watchdog of `arm`, also while simulated time is paused.
        self.create_timer(0.2, self.publish_alive, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health, period=HEARTBEAT)

    def close(self) -> None:
        """Stop the planner's thread."""
        self.planner.shutdown(cancel_futures=True)

    def now(self) -> int:
        """Return the time of the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def tick(self) -> None:
        """Resume the goal that waits for the arm to rest, or for its plan."""
        self.next_tick, next_tick = Future(), self.next_tick
        next_tick.set_result(None)

    def publish_alive(self) -> None:
        """Publish that the current trajectory is still wanted."""
        if self.trajectory_goal is not None:
            self.alive.publish(self.trajectory_goal.goal_id)

    def on_joints(self, message: JointState) -> None:
        """Store the state of all joints."""
        readings = sorted(joint_readings(message))
        q, qd = (np.array([row[k] for row in readings]) for k in (1, 2))
        self.joints = Joints(stamp_ns(message.header.stamp), q, qd)
        self.joint_track.add(self.joints.t, q.tolist())
        if np.abs(qd).max(initial=0.0) > self.settings.motion_threshold:
            self.moved = self.joints.t

    def on_base(self, message: Odometry) -> None:
        """Store the pose of the base."""
        self.base.add(stamp_ns(message.header.stamp), planar_pose(message.pose.pose))

    def on_calibration(self, topic: str, message: Any) -> None:
        """Use a calibration that passed for later plans."""
        try:
            self.calibrated = self.calibrated.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"{topic} is left out: {error}")

    def on_goal(self, goal: ExecuteMotion.Goal) -> GoalResponse:
        """Accept one motion at a time; the reason of a rejection is logged."""
        if why := "another motion is being executed" if self.busy else oversized(goal):
            self.get_logger().warning(f"goal rejected: {why}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def on_cancel(self, _: Any) -> CancelResponse:
        """Stop the arm."""
        if self.trajectory_goal is not None:
            self.trajectory_goal.cancel_goal_async()
        return CancelResponse.ACCEPT

    async def on_execute(self, handle: ServerGoalHandle) -> ExecuteMotion.Result:
        """Plan and execute a motion."""
        self.busy, result = True, ExecuteMotion.Result()
        try:
            await self.wait_for_rest(handle)
            plan = await self.plan(self.start(), handle)
            result.report, result.message = await self.execute(plan, handle)
            self.report.publish(result.report)
        except (ValueError, OSError) as error:
            result.message = " ".join(str(error).split())
        finally:
            self.busy, self.trajectory_goal = False, None
        result.reached = not result.message
        if result.reached:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            self.get_logger().warning(f"motion ended: {result.message}")
            handle.abort()
        return result

    async def wait_for_rest(self, handle: ServerGoalHandle) -> None:
        """Wait until the base's drift since the last motion is known; not for an arm that moves.

        Raises:
            MotionError: cancelled meanwhile.
        """
        window = round(self.settings.rest_window * SECOND)
        deadline = self.now() + 2 * window
        while self.joints.t < self.moved + window and self.now() < deadline:
            if handle.is_cancel_requested:
                raise MotionError("cancelled")
            await self.next_tick

    def start(self) -> Start:
        """Return the initial state of a plan; a base without poses is assumed to be at rest.

        Raises:
            MotionError: joint states are missing or too old, or the arm moves.
        """
        s, joints, n = self.settings, self.joints, self.calibrated.arm.n
        if (age := (self.now() - joints.t) / SECOND) > s.max_age or joints.q.shape != (n,):
            problem = f"is {age:.1f} s old" if joints.t else "was not received yet"
            raise MotionError(f"arm/joint_states {problem}: check that arm and all links run")
        if (fast := np.abs(joints.qd)).max() > s.motion_threshold:
            i = int(fast.argmax())
            raise MotionError(
                f"joint {i + 1} moves at {joints.qd[i]:.3f} rad/s; wait until the arm rests"
            )
        arm, C = self.calibrated.arm, self.calibrated.covariance
        start = Start(arm, joints.q, covariance=C, tracking=s.tracking)
        base = self.base.drift(joints.t, s.rest_window)
        settling = self.joint_track.drift(joints.t, s.rest_window)
        if base is None or settling is None:
            return start
        # Momentum by unit rates of base and joints; settling joints turn the base, too.
        by_rates = momentum(arm.vector(), np.concatenate([base.at, joints.q]), np.eye(3 + n)).T
        C = np.zeros((6, 6))  # of pose and momentum
        C[3:, 3:] = by_rates[:, :3] @ base.covariance @ by_rates[:, :3].T
        P = by_rates @ np.concatenate([base.rate, settling.rate])
        return replace(start, pose=base.at, momentum=P, state_covariance=C)

    async def plan(self, start: Start, handle: ServerGoalHandle) -> Plan:
        """Plan the motion of a goal in the planner's thread.

        Raises:
            ValueError: there is none, or the goal was cancelled meanwhile.
            OSError: its file cannot be read.
        """
        goal = handle.request
        if bool(goal.kind) == bool(goal.file):
            raise MotionError("the goal must have either a kind or a file")
        make: Callable[[], Plan]
        if goal.file:
            make = partial(self.from_file, start, Path(goal.file))
        else:
            kind, settings = options_of(goal.kind, goal.arguments)
            make = partial(kind.plan, start, settings)
        job = self.planner.submit(make)
        while not job.done():
            if handle.is_cancel_requested:
                raise MotionError("cancelled")
            await self.next_tick
        plan = job.result()
        if why := too_long(plan):
            raise MotionError(why)
        return plan

    def from_file(self, start: Start, path: Path) -> Plan:
        """Return a stored plan, with the base's motion predicted from its present state."""
        plan = parsed(path).plan
        if plan.q.shape[1] != len(start.q):
            raise MotionError(f"{path} is for {plan.q.shape[1]} joints, the arm has {len(start.q)}")
        distance = np.abs(plan.q[0] - start.q)
        if distance.max() > self.settings.tolerance:
            i = int(distance.argmax())
            raise MotionError(
                f"joint {i + 1} is at {np.degrees(start.q[i]):.2f} deg, {path} starts at "
                f"{np.degrees(plan.q[0][i]):.2f} deg"
            )
        base = predicted(start, plan.times, plan.q, plan.qd)
        return Plan(plan.kind, plan.arguments, plan.times, plan.q, plan.qd, base, plan.used)

    async def execute(self, plan: Plan, handle: ServerGoalHandle) -> tuple[MotionReport, str]:
        """Execute a plan; return the report, and why the motion ended early (empty: it did not).

        Raises:
            MotionError: the node arm does not run, or rejects the trajectory.
        """
        if not self.controller.server_is_ready():
            raise MotionError(f"no node offers {CONTROLLER}: start the node arm")
        start_time = self.now() + round(self.settings.lead * SECOND)
        end = start_time + round(plan.duration * SECOND)

        def feedback(_: Any) -> None:
            remaining = max(0.0, (end - self.now()) / SECOND)
            handle.publish_feedback(ExecuteMotion.Feedback(remaining=remaining))

        trajectory_goal = await self.controller.send_goal_async(
            trajectory(plan, start_time), feedback
        )
        if not trajectory_goal.accepted:
            raise MotionError("the node arm rejected the trajectory: see its log")
        self.trajectory_goal = trajectory_goal
        if handle.is_cancel_requested:  # cancelled before the trajectory was accepted
            trajectory_goal.cancel_goal_async()
        ended = await trajectory_goal.get_result_async()
        reached = ended.status == GoalStatus.STATUS_SUCCEEDED
        report = self.motion_report(
            plan, handle.request, start_time, end if reached else self.now()
        )
        return report, "" if reached else ended.result.error_string

    def motion_report(
        self, plan: Plan, goal: ExecuteMotion.Goal, start_time: int, end: int
    ) -> MotionReport:
        """Return the predicted and measured motion of the base."""
        base = plan.prediction
        moved, excursion = self.base.moved(start_time, end) or (
            np.full(3, np.nan),
            np.full(3, np.nan),
        )
        has_covariance = self.calibrated.covariance.any()
        report = MotionReport(
            kind=plan.kind,
            arguments=list(goal.arguments),
            arm=self.calibrated.arm.name,
            duration=plan.duration,
            predicted=base.pose[-1] - base.pose[0],
            predicted_deviation=base.deviation[-1] if has_covariance else np.full(3, np.nan),
            measured=moved,
            predicted_excursion=base.excursion,
            measured_excursion=excursion[2],
        )
        report.header.stamp, report.header.frame_id = to_time(start_time), "world"
        return report

    def health(self) -> Health:
        """Return the diagnostic status."""
        try:
            self.start()
        except ValueError as error:
            return Health(OK, "moving") if self.busy else Health(WARN, str(error))
        has_base = self.base.drift(self.joints.t, self.settings.rest_window) is not None
        text = (
            "ready" if has_base else "ready, but without poses of the base: assumed to be at rest"
        )
        return Health(OK if has_base else WARN, text)


if __name__ == "__main__":
    sys.exit(main())
