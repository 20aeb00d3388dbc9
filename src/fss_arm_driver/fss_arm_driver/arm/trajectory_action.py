"""Action and topic of a joint trajectory controller, named `arm_controller`."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from unique_identifier_msgs.msg import UUID

from fss_arm_driver.arm.arbiter import Motion
from fss_arm_driver.arm.guard_topics import GuardTopics
from fss_arm_driver.arm.link_topics import LinkTopics, MotionError
from fss_arm_driver.arm.request import (
    Code,
    Request,
    TrajectoryError,
    parse_request,
    reject_unsupported_fields,
)
from fss_arm_driver.arm.tolerance import Tolerance, Tolerances
from fss_arm_driver.arm.trajectory import Trajectory, check_time, plan_trajectory
from fss_arm_driver.arm.trajectory_monitor import Progress, TrajectoryMonitor
from fss_arm_driver.liveness import GoalClient
from fss_arm_model.arrays import Floats
from fss_arm_model.description import joint_names
from fss_arm_model.guard.guard import GuardError
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.goal_thread import GoalThread
from fss_arm_ros.subscriptions import Topic
from fss_arm_ros.validation import subscribe

CONTROLLER = "arm_controller"
CANCELED = "canceled"
RESULT_SERVICE = (
    f"{CONTROLLER}/follow_joint_trajectory/_action/get_result"  # its clients await results
)
KEEP_ALIVE = 1.0  # timeout of a client that has sent a keep-alive [s]


class TrajectoryAction:
    """Server that makes the links follow trajectories; a new one replaces the current one."""

    def __init__(self, links: LinkTopics, guard: GuardTopics) -> None:
        self.links, self.guard, node, s = links, guard, links.node, links.settings
        goal = Tolerance(s.tolerance, s.motion_threshold)
        n = links.arm.n
        self.tolerances = Tolerances((Tolerance(s.path_tolerance),) * n, (goal,) * n, s.max_overrun)
        self.motion: Motion | None = None
        self.trajectory: Trajectory | None = None  # of that motion
        self.goal, self.client = b"", GoalClient(0.0, 0.0)  # the goal's id, and its client
        subscribe(node, UUID, f"{CONTROLLER}/alive", self.on_alive, 10)
        self.received: tuple[Request, Tolerances] | None = None  # the last goal received
        self.accepted: dict[bytes, tuple[Request, Tolerances]] = {}  # goals to execute, by id
        topic = Topic(
            JointTrajectory, f"{CONTROLLER}/joint_trajectory", QoSProfile(depth=1), self.on_message
        )
        self.thread = GoalThread(node, [topic])
        self.close = self.thread.close
        self.thread.serve(
            ActionServer(
                node,
                FollowJointTrajectory,
                f"{CONTROLLER}/follow_joint_trajectory",
                self.on_execute,
                goal_callback=self.on_goal,
                handle_accepted_callback=self.on_accepted,
                cancel_callback=self.on_cancel,
                callback_group=self.thread.group,
            )
        )

    @property
    def earliest(self) -> int:
        """Earliest start of a path that is sent now [ns]."""
        return self.links.now() + round(self.links.settings.lead * SECOND)

    def on_goal(self, goal: FollowJointTrajectory.Goal) -> GoalResponse:
        """Reject a malformed or oversized goal; the reason is logged, as the answer has none."""
        try:
            reject_unsupported_fields(goal)
            tolerances = self.tolerances.with_goal(goal)
            request = parse_request(self.links.arm, goal.trajectory)
            check_time(request, self.earliest)
        except TrajectoryError as error:
            self.warn("goal rejected", error)
            return GoalResponse.REJECT
        self.received = request, tolerances
        return GoalResponse.ACCEPT

    def on_accepted(self, handle: ServerGoalHandle) -> None:
        """Execute the goal last received, in the node's executor."""
        received, self.received = self.received, None
        assert received  # by on_goal, just before
        self.accepted[handle.goal_id.uuid.tobytes()] = received
        handle.execute()

    def on_cancel(self, _: Any) -> CancelResponse:
        """Accept that the client cancels a goal."""
        self.links.wake()
        return CancelResponse.ACCEPT

    def on_alive(self, goal: UUID) -> None:
        """Store a keep-alive of the client; from then on it must keep sending them."""
        if goal.uuid.tobytes() == self.goal:
            self.client.last_alive, self.client.keep_alive = time.monotonic(), KEEP_ALIVE

    async def on_execute(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        """Execute a goal that was accepted."""
        code, words = Code.SUCCESSFUL, "goal reached"
        try:
            await self.follow(*self.accepted.pop(handle.goal_id.uuid.tobytes()), handle)
            handle.succeed()
        except TrajectoryError as error:
            code, words = error.code, str(error)
            if words == CANCELED:
                handle.canceled()
            else:
                self.warn("trajectory ended", error)
                handle.abort()
        return FollowJointTrajectory.Result(error_code=int(code), error_string=words)

    def on_message(self, message: JointTrajectory) -> None:
        """Start a trajectory that has no client."""
        try:
            request = parse_request(self.links.arm, message)
        except TrajectoryError as error:
            self.warn("trajectory rejected", error)
            return
        self.links.node.executor.create_task(self.follow_without_client(request))

    async def follow_without_client(self, request: Request) -> None:
        """Follow a trajectory; the log says why it ended, if not by reaching its goal."""
        try:
            await self.follow(request, self.tolerances)
        except TrajectoryError as error:
            self.warn("trajectory ended", error)

    def warn(self, what: str, error: TrajectoryError) -> None:
        """Log how a trajectory ended."""
        self.links.node.get_logger().warning(f"{what}: {error.code.name}: {error}")

    async def follow(
        self, request: Request, tolerances: Tolerances, handle: ServerGoalHandle | None = None
    ) -> None:
        """Make the links follow a requested trajectory until they reach the goal.

        Raises:
            TrajectoryError: it cannot start, or ended early.
        """
        links = self.links
        try:
            links.check()
            trajectory = plan_trajectory(links.arm, request, self.earliest, self.start_state)
            self.guard.check_trajectory(trajectory)
        except (MotionError, GuardError) as error:
            raise TrajectoryError(Code.INVALID_GOAL, str(error)) from None
        motion = self.motion = links.arbiter.start("a trajectory", links.now())
        self.trajectory, motion.plan = trajectory, trajectory.at
        self.goal = handle.goal_id.uuid.tobytes() if handle else b""
        self.client = GoalClient(0.0, time.monotonic())
        links.wake()  # the preempted motion ends
        try:
            await self.supervise(
                TrajectoryMonitor(trajectory, tolerances, self.start_timeout), motion, handle
            )
        except TrajectoryError:
            links.stop_joints(motion)
            raise
        finally:
            links.arbiter.finish(motion)

    @property
    def start_timeout(self) -> float:
        """Time after the start of a path within which the links must follow it [s]."""
        return self.links.settings.time_to_live

    async def supervise(
        self, monitor: TrajectoryMonitor, motion: Motion, handle: ServerGoalHandle | None
    ) -> None:
        """Repeat the commands while the links follow, and publish feedback."""
        links = self.links
        commands = links.publish_path(monitor.trajectory)
        while True:
            links.send(commands, links.now(), motion)
            await links.ticked
            if handle and handle.is_cancel_requested:
                raise TrajectoryError(Code.SUCCESSFUL, CANCELED)
            connected = bool(links.node.count_clients(RESULT_SERVICE))
            if handle and (reason := self.client.lost_reason(time.monotonic(), connected)):
                raise TrajectoryError(Code.INVALID_GOAL, reason)
            try:
                links.check(motion)
                self.guard.check_trajectory(monitor.trajectory, links.now())
            except (MotionError, GuardError) as error:
                raise TrajectoryError(Code.INVALID_GOAL, str(error)) from None
            if links.refusals:
                words = "; ".join(f"link {i}: {why}" for i, why in links.refusals.items())
                raise TrajectoryError(Code.INVALID_GOAL, f"the path is refused by {words}")
            if handle:
                handle.publish_feedback(self.feedback(monitor.progress(links.states)))
            if monitor.is_goal_reached(links.states):
                return

    def start_state(self, time: int) -> tuple[Floats, Floats]:
        """Return q and qd of the arm at a time: on its trajectory, or after it came to rest."""
        links = self.links
        if self.trajectory and links.arbiter.is_current(self.motion, links.now()):
            return self.trajectory.at(time)
        states = [links.states[i] for i in links.numbers]
        gains = [link.drive.max_acceleration for link in links.arm.links]
        q = [s.q + s.qd * abs(s.qd) / (2.0 * a) for s, a in zip(states, gains, strict=True)]
        return np.array(q), np.zeros(links.arm.n)

    def feedback(self, progress: Progress) -> FollowJointTrajectory.Feedback:
        """Return the progress as a message."""
        since = Duration(seconds=max(0.0, progress.time)).to_msg()

        def point(value: Callable[[int], Floats]) -> JointTrajectoryPoint:
            return JointTrajectoryPoint(
                positions=value(0).tolist(), velocities=value(1).tolist(), time_from_start=since
            )

        message = FollowJointTrajectory.Feedback(
            joint_names=joint_names(self.links.arm.n),
            desired=point(lambda k: progress.desired[k]),
            actual=point(lambda k: progress.actual[k]),
            error=point(lambda k: progress.desired[k] - progress.actual[k]),
        )
        message.header.stamp = to_time(self.links.now())
        return message
