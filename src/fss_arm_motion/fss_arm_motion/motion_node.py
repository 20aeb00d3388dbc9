"""Node `motion`: plans motions from the measured state, runs them, and reports on the base."""

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from action_msgs.msg import GoalStatus
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState

from fss_arm_motion.arm_action import ArmClient
from fss_arm_motion.measured import REST_WINDOW, Measured, MotionError
from fss_arm_motion.messages import motion_report, oversized, planning, trajectory
from fss_arm_motion.plan import Plan
from fss_arm_motion.programs import motion as main
from fss_arm_motion.settings import MotionSettings
from fss_arm_msgs.action import ExecuteMotion
from fss_arm_msgs.msg import MotionReport
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.calibrations import subscribe_calibrations
from fss_arm_ros.convert import SECOND, joint_readings, planar_pose, stamp_ns
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.timers import timer_clock

HEARTBEAT = 0.5  # of diagnostics: at most 1 s old, whatever the planner's thread does [s]


class MotionNode(Node):
    """Serves the action `arm/execute`: plans a motion, sends it to `arm`, reports it."""

    def __init__(self, **options: Any) -> None:
        super().__init__("motion", **options)
        self.settings = declare(self, MotionSettings)
        self.calibrated = Calibrated(load_described_arm(self, self.settings.arm))
        self.measured = Measured(self.settings)
        self.busy = False
        self.next_tick: Future = Future()
        self.planner = ThreadPoolExecutor(1, "planner")  # the node must not wait for a plan
        subscribe_sensor(self, JointState, "arm/joint_states", self.on_joints)
        subscribe_sensor(self, Odometry, "base/state", self.on_base)
        subscribe_calibrations(self, self.on_calibration)
        group = ReentrantCallbackGroup()  # callbacks run while a motion is executed
        self.arm = ArmClient(self, group)
        self.report = self.create_publisher(MotionReport, "arm/motion", LATCHED)
        callbacks = {"goal_callback": self.on_goal, "cancel_callback": self.on_cancel}
        self.server = ActionServer(
            self, ExecuteMotion, "arm/execute", self.on_execute, callback_group=group, **callbacks
        )
        self.create_timer(0.1, self.tick, clock=timer_clock(self))
        self.get_logger().info("ready for arm/execute")
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

    def on_joints(self, message: JointState) -> None:
        """Store the state of all joints."""
        self.measured.add_joints(stamp_ns(message.header.stamp), joint_readings(message))

    def on_base(self, message: Odometry) -> None:
        """Store the pose of the base."""
        self.measured.base.add(stamp_ns(message.header.stamp), planar_pose(message.pose.pose))

    def on_calibration(self, topic: str, message: Any) -> None:
        """Use a calibration that passed for later plans."""
        try:
            self.calibrated = self.calibrated.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"{topic} rejected: {error}")

    def on_goal(self, goal: ExecuteMotion.Goal) -> GoalResponse:
        """Accept one motion at a time; the reason of a rejection is logged."""
        if why := "another motion is being executed" if self.busy else oversized(goal):
            self.get_logger().warning(f"goal rejected: {why}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def on_cancel(self, _: Any) -> CancelResponse:
        """Stop the arm."""
        self.arm.cancel()
        return CancelResponse.ACCEPT

    async def on_execute(self, handle: ServerGoalHandle) -> ExecuteMotion.Result:
        """Plan and execute a motion."""
        self.busy, result = True, ExecuteMotion.Result()
        try:
            plan = await self.plan(handle)
            result.report, result.message = await self.execute(plan, handle)
            self.report.publish(result.report)
        except (ValueError, OSError) as error:
            result.message = " ".join(str(error).split())
        finally:
            self.busy = False
        result.reached = not result.message
        if result.reached:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            self.get_logger().warning(f"motion ended: {result.message}")
            handle.abort()
        return result

    async def wait(self, handle: ServerGoalHandle, condition: Callable[[], bool]) -> None:
        """Wait until a condition holds.

        Raises:
            MotionError: the goal was canceled meanwhile.
        """
        while not condition():
            if handle.is_cancel_requested:
                raise MotionError("canceled")
            await self.next_tick

    async def plan(self, handle: ServerGoalHandle) -> Plan:
        """Plan the motion of a goal, once the base's drift is known or the arm does not rest.

        Raises:
            ValueError: there is none, or the goal was canceled meanwhile.
            OSError: its file cannot be read.
        """
        deadline = self.now() + 2 * round(REST_WINDOW * SECOND)
        await self.wait(handle, lambda: self.measured.has_rested or self.now() >= deadline)
        start = self.measured.start(self.now(), self.calibrated)
        job = self.planner.submit(planning(handle.request, start, self.settings.tolerance))
        await self.wait(handle, job.done)
        return job.result()

    async def execute(self, plan: Plan, handle: ServerGoalHandle) -> tuple[MotionReport, str]:
        """Execute a plan; return the report, and why the motion ended early (empty: it did not).

        Raises:
            MotionError: the node arm does not run, or rejects the trajectory.
        """
        start_time = self.now() + round(self.settings.lead * SECOND)
        end = start_time + round(plan.duration * SECOND)

        def feedback(_: Any) -> None:
            remaining = max(0.0, (end - self.now()) / SECOND)
            handle.publish_feedback(ExecuteMotion.Feedback(remaining=remaining))

        ended = await self.arm.follow(trajectory(plan, start_time), handle, feedback)
        reached = ended.status == GoalStatus.STATUS_SUCCEEDED
        moved = self.measured.base.moved(start_time, end if reached else self.now())
        report = motion_report(plan, handle.request.arguments, self.calibrated, start_time, moved)
        return report, "" if reached else ended.result.error_string

    def health(self) -> Health:
        """Return the diagnostic status."""
        try:
            self.measured.start(self.now(), self.calibrated)
        except ValueError as error:
            return Health(OK, "moving") if self.busy else Health(WARN, str(error))
        if self.measured.has_base:
            return Health(OK, "ready")
        return Health(WARN, "ready, but without poses of the base: assumed to be at rest")


if __name__ == "__main__":
    sys.exit(main())
