"""The node `motion`: plans from where arm and base are, runs them, and says what the base did."""

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
    """A motion cannot begin, or ended early; the message says why."""


@dataclass(frozen=True)
class Joints:
    """All joints at one time."""

    t: int  # [ns]
    q: Floats  # (n,) [rad]
    qd: Floats  # (n,) [rad/s]


class MotionNode(Node):
    """Executes `arm/execute`: plans, has the links follow, reports on `arm/motion`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("motion", **options)
        self.settings = declare(self, MotionSettings)
        self.known = Calibrated(described(self.settings.arm))
        self.joints = Joints(0, np.zeros(0), np.zeros(0))
        self.base, self.readings = Track(angle=2), Track()
        self.moved = 0  # when a joint last did [ns]
        self.busy = False
        self.following: Any = None  # the trajectory that the arm's node follows for us
        self.ticked: Future = Future()
        self.planner = ThreadPoolExecutor(1, "planner")  # the node must not wait for a plan
        subscribe_sensor(self, JointState, "arm/joint_states", self.on_joints)
        subscribe_sensor(self, Odometry, "base/state", self.on_base)
        for topic, kind in CALIBRATIONS.items():
            subscribe(self, kind, topic, partial(self.on_calibration, topic), LATCHED)
        group = ReentrantCallbackGroup()  # a motion takes its time; all else goes on
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
        # In real time, as whoever listens counts it, also while a simulated one stands still.
        self.create_timer(0.2, self.show_life, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health, period=HEARTBEAT)

    def close(self) -> None:
        """End the planner's thread."""
        self.planner.shutdown(cancel_futures=True)

    def now(self) -> int:
        """The node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def tick(self) -> None:
        """Resume the goal that waits for the arm to rest, or for its plan."""
        self.ticked, ticked = Future(), self.ticked
        ticked.set_result(None)

    def show_life(self) -> None:
        """Say that the path under way is still wanted."""
        if self.following is not None:
            self.alive.publish(self.following.goal_id)

    def on_joints(self, message: JointState) -> None:
        """Where all joints are."""
        readings = sorted(joint_readings(message))
        q, qd = (np.array([row[k] for row in readings]) for k in (1, 2))
        self.joints = Joints(stamp_ns(message.header.stamp), q, qd)
        self.readings.add(self.joints.t, q.tolist())
        if np.abs(qd).max(initial=0.0) > self.settings.motion_threshold:
            self.moved = self.joints.t

    def on_base(self, message: Odometry) -> None:
        """Where the base is."""
        self.base.add(stamp_ns(message.header.stamp), planar_pose(message.pose.pose))

    def on_calibration(self, topic: str, message: Any) -> None:
        """Plan with it from now on, if it passed."""
        try:
            self.known = self.known.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"{topic} is left out: {error}")

    def on_goal(self, goal: ExecuteMotion.Goal) -> GoalResponse:
        """Accept one motion at a time; the reason of a rejection is logged."""
        if why := "a motion is under way" if self.busy else oversized(goal):
            self.get_logger().warning(f"goal rejected: {why}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def on_cancel(self, _: Any) -> CancelResponse:
        """Have the arm come to rest."""
        if self.following is not None:
            self.following.cancel_goal_async()
        return CancelResponse.ACCEPT

    async def on_execute(self, handle: ServerGoalHandle) -> ExecuteMotion.Result:
        """Plan and run."""
        self.busy, result = True, ExecuteMotion.Result()
        try:
            await self.rest(handle)
            plan = await self.plan(self.start(), handle)
            result.report, result.message = await self.follow(plan, handle)
            self.report.publish(result.report)
        except (ValueError, OSError) as error:
            result.message = " ".join(str(error).split())
        finally:
            self.busy, self.following = False, None
        result.reached = not result.message
        if result.reached:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            self.get_logger().warning(f"motion ended: {result.message}")
            handle.abort()
        return result

    async def rest(self, handle: ServerGoalHandle) -> None:
        """Wait until the base's drift since the last motion is known; not for an arm that moves.

        Raises:
            MotionError: cancelled meanwhile.
        """
        window = round(self.settings.rest_window * SECOND)
        patience = self.now() + 2 * window
        while self.joints.t < self.moved + window and self.now() < patience:
            if handle.is_cancel_requested:
                raise MotionError("cancelled")
            await self.ticked

    def start(self) -> Start:
        """Where a plan begins now; a base that is not seen is taken to be at rest.

        Raises:
            MotionError: the arm is not heard, or moves.
        """
        s, joints, n = self.settings, self.joints, self.known.arm.n
        if (age := (self.now() - joints.t) / SECOND) > s.max_age or joints.q.shape != (n,):
            what = f"is {age:.1f} s old" if joints.t else "was not heard yet"
            raise MotionError(f"arm/joint_states {what}: is the node arm there, and every link?")
        if (fast := np.abs(joints.qd)).max() > s.motion_threshold:
            i = int(fast.argmax())
            raise MotionError(f"joint {i + 1} moves with {joints.qd[i]:.3f} rad/s, expected rest")
        arm, C = self.known.arm, self.known.covariance
        start = Start(arm, joints.q, covariance=C, tracking=s.tracking)
        base = self.base.drift(joints.t, s.rest_window)
        settling = self.readings.drift(joints.t, s.rest_window)
        if base is None or settling is None:
            return start
        # By unit rates of base and joints, which turn the base, too, as they settle.
        by_rates = momentum(arm.vector(), np.concatenate([base.at, joints.q]), np.eye(3 + n)).T
        C = np.zeros((6, 6))  # of pose and momentum
        C[3:, 3:] = by_rates[:, :3] @ base.covariance @ by_rates[:, :3].T
        P = by_rates @ np.concatenate([base.rate, settling.rate])
        return replace(start, pose=base.at, momentum=P, state_covariance=C)

    async def plan(self, start: Start, handle: ServerGoalHandle) -> Plan:
        """Plan the motion that a goal asks for, in the planner's thread.

        Raises:
            ValueError: there is none, or the goal was cancelled meanwhile.
            OSError: its file cannot be read.
        """
        goal = handle.request
        if bool(goal.kind) == bool(goal.file):
            raise MotionError("expected a kind or a file, and not both")
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
            await self.ticked
        plan = job.result()
        if why := too_long(plan):
            raise MotionError(why)
        return plan

    def from_file(self, start: Start, path: Path) -> Plan:
        """A plan that was made before, with what the base will do from where it is now."""
        plan = parsed(path).plan
        if plan.q.shape[1] != len(start.q):
            raise MotionError(f"{path} is for {plan.q.shape[1]} joints, the arm has {len(start.q)}")
        off = np.abs(plan.q[0] - start.q)
        if off.max() > self.settings.tolerance:
            i = int(off.argmax())
            raise MotionError(
                f"joint {i + 1} is at {np.degrees(start.q[i]):.2f} deg, {path} begins at "
                f"{np.degrees(plan.q[0][i]):.2f} deg"
            )
        base = predicted(start, plan.times, plan.q, plan.qd)
        return Plan(plan.kind, plan.arguments, plan.times, plan.q, plan.qd, base, plan.used)

    async def follow(self, plan: Plan, handle: ServerGoalHandle) -> tuple[MotionReport, str]:
        """Have the arm follow; what came of it, and why it ended early, if it did.

        Raises:
            MotionError: the arm's node is not there, or rejects it.
        """
        if not self.controller.server_is_ready():
            raise MotionError(f"no node offers {CONTROLLER}: is the node arm there?")
        begin = self.now() + round(self.settings.lead * SECOND)
        end = begin + round(plan.duration * SECOND)

        def feedback(_: Any) -> None:
            left = max(0.0, (end - self.now()) / SECOND)
            handle.publish_feedback(ExecuteMotion.Feedback(remaining=left))

        following = await self.controller.send_goal_async(trajectory(plan, begin), feedback)
        if not following.accepted:
            raise MotionError("the arm's node rejected the path: its log says why")
        self.following = following
        if handle.is_cancel_requested:  # before there was anything to cancel
            following.cancel_goal_async()
        ended = await following.get_result_async()
        reached = ended.status == GoalStatus.STATUS_SUCCEEDED
        report = self.reported(plan, handle.request, begin, end if reached else self.now())
        return report, "" if reached else ended.result.error_string

    def reported(self, plan: Plan, goal: ExecuteMotion.Goal, begin: int, end: int) -> MotionReport:
        """What the base was to do and did."""
        base = plan.prediction
        moved, most = self.base.moved(begin, end) or (np.full(3, np.nan), np.full(3, np.nan))
        known = self.known.covariance.any()
        report = MotionReport(
            kind=plan.kind,
            arguments=list(goal.arguments),
            arm=self.known.arm.name,
            duration=plan.duration,
            predicted=base.pose[-1] - base.pose[0],
            predicted_deviation=base.deviation[-1] if known else np.full(3, np.nan),
            measured=moved,
            predicted_excursion=base.excursion,
            measured_excursion=most[2],
        )
        report.header.stamp, report.header.frame_id = to_time(begin), "world"
        return report

    def health(self) -> Health:
        """For diagnostics."""
        try:
            self.start()
        except ValueError as error:
            return Health(OK, "moving") if self.busy else Health(WARN, str(error))
        seen = self.base.drift(self.joints.t, self.settings.rest_window) is not None
        words = "ready" if seen else "ready, but the base is not seen: taken to be at rest"
        return Health(OK if seen else WARN, words)


if __name__ == "__main__":
    sys.exit(main())
