"""Client of the node `arm`, which has the links follow a trajectory."""

from collections.abc import Callable
from typing import Any

from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from unique_identifier_msgs.msg import UUID

from fss_arm_motion.measured import MotionError

CONTROLLER = "arm_controller/follow_joint_trajectory"


class ArmClient:
    """Client of a node for one trajectory at a time; the arm stops soon after the node dies."""

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self.goal: Any = None  # handle of the trajectory that the arm follows
        self.client = ActionClient(node, FollowJointTrajectory, CONTROLLER, callback_group=group)
        self.alive = node.create_publisher(UUID, "arm_controller/alive", 10)
        # In real time, as in the watchdog of `arm`, also while simulated time is paused.
        node.create_timer(0.2, self.publish_alive, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish_alive(self) -> None:
        """Publish that the current trajectory is still wanted."""
        if self.goal is not None:
            self.alive.publish(self.goal.goal_id)

    def cancel(self) -> None:
        """Stop the arm, if it follows a trajectory."""
        if self.goal is not None:
            self.goal.cancel_goal_async()

    async def follow(
        self,
        trajectory: FollowJointTrajectory.Goal,
        handle: ServerGoalHandle,
        feedback: Callable[[Any], None],
    ) -> Any:
        """Follow a trajectory for a goal; return its status and result.

        Raises:
            MotionError: the node arm does not run, or rejects the trajectory.
        """
        if not self.client.server_is_ready():
            raise MotionError(f"no node offers {CONTROLLER}: start the node arm")
        goal = await self.client.send_goal_async(trajectory, feedback)
        if not goal.accepted:
            raise MotionError("the node arm rejected the trajectory: see its log")
        self.goal = goal
        self.publish_alive()
        try:
            if handle.is_cancel_requested:  # canceled before the trajectory was accepted
                self.cancel()
            return await goal.get_result_async()
        finally:
            self.goal = None
