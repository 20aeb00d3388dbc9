"""Action `arm/move`: moves all joints to given angles, with simultaneous arrival."""

import time
from math import degrees
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from unique_identifier_msgs.msg import UUID

from fss_arm_driver.arm.arbiter import Motion
from fss_arm_driver.arm.guard_topics import GuardTopics
from fss_arm_driver.arm.link_topics import LinkTopics, MotionError
from fss_arm_driver.arm.move import Move, MoveError, Profile, check, load_kernel, plan
from fss_arm_driver.liveness import GoalClient
from fss_arm_model.guard.guard import GuardError
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import LinkCommand
from fss_arm_ros.convert import SECOND
from fss_arm_ros.validation import subscribe

RESULT_SERVICE = "arm/move/_action/get_result"  # service that the clients of the action use


class MoveAction:
    """Server that executes moves, one at a time; the client of a move must stay alive."""

    def __init__(self, links: LinkTopics, guard: GuardTopics) -> None:
        self.links, self.guard, node = links, guard, links.node
        load_kernel(links.arm)
        self.goal_id = b""  # id of the goal
        self.last_reason = ""  # why the last move ended, if its goal was not reached
        self.client = GoalClient(0.0, 0.0)
        subscribe(node, UUID, "arm/move/alive", self.on_alive, 10)
        self.server = ActionServer(
            node,
            MoveArm,
            "arm/move",
            self.on_move,
            goal_callback=self.on_goal,
            cancel_callback=self.on_cancel,
            callback_group=ReentrantCallbackGroup(),  # other callbacks run during a move
        )

    def on_alive(self, goal: UUID) -> None:
        """Note that the client of a move is alive."""
        if goal.uuid.tobytes() == self.goal_id:
            self.client.last_alive = time.monotonic()

    def on_goal(self, goal: MoveArm.Goal) -> GoalResponse:
        """Reject an invalid goal; the reason is logged, because the response cannot contain it."""
        try:
            check(self.links.arm, goal.q, goal.duration, goal.keep_alive)
        except MoveError as error:
            self.links.node.get_logger().warning(f"move rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def on_cancel(self, _: Any) -> CancelResponse:
        """Accept that the client cancels a move."""
        self.links.wake()
        return CancelResponse.ACCEPT

    async def on_move(self, handle: ServerGoalHandle) -> MoveArm.Result:
        """Execute `arm/move`."""
        message = ""
        try:
            await self.execute(handle)
        except (MotionError, GuardError) as error:
            message = str(error)
        if not message:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            log = self.links.node.get_logger()
            if message == self.last_reason:
                pass  # a waiting client repeats its goal
            elif self.links.unconnected:  # the nodes have just started
                log.info(f"moves are refused until the links are ready: {message}")
            else:
                log.warning(f"move aborted: {message}")
            handle.abort()
        self.last_reason = message
        return MoveArm.Result(reached=not message, message=message, q=self.links.q())

    async def execute(self, handle: ServerGoalHandle) -> None:
        """Plan and execute a move until its goal is reached.

        Raises:
            MotionError: the move cannot start, or ended early.
            GuardError: bodies would come too close.
        """
        links, request = self.links, handle.request
        if other := links.arbiter.current_name(links.now()):
            raise MotionError(f"{other} is in progress")
        links.check()
        move = plan(links.arm, links.q(), tuple(request.q), request.duration)
        if 0.0 < request.duration < move.duration:
            words = f"takes {move.duration:.2f} s instead of {request.duration:.2f} s"
            links.node.get_logger().info(f"the move {words}, as the joints' limits require")
        self.guard.check_move(links.states, move.profiles)
        motion = links.arbiter.start("a move", links.now())
        self.goal_id = handle.goal_id.uuid.tobytes()
        self.client = GoalClient(request.keep_alive, time.monotonic())
        try:
            await self.repeat_commands(handle, move, motion)
        except (MotionError, GuardError):
            links.stop_joints(motion)
            raise
        finally:
            links.arbiter.finish(motion)
            self.goal_id = b""

    async def repeat_commands(self, handle: ServerGoalHandle, move: Move, motion: Motion) -> None:
        """Repeat the commands until all joints have arrived."""
        links, start = self.links, self.links.now()
        given, motion.plan = start, lambda at: move.at((at - start) / SECOND)
        longest = move.duration + links.settings.max_overrun
        while not self.is_reached(move):
            elapsed = (links.now() - start) / SECOND
            if elapsed > longest:
                worst = self.describe_farthest(move)
                raise MotionError(f"goal not reached within {elapsed:.1f} s: {worst}")
            links.send({i: position(p) for i, p in enumerate(move.profiles, 1)}, given, motion)
            remaining = max(0.0, move.duration - elapsed)
            handle.publish_feedback(MoveArm.Feedback(q=links.q(), remaining=remaining))
            await links.ticked
            given = links.now()
            self.check(handle, motion)
            self.guard.check_move(links.states, move.profiles, longest - elapsed)

    def check(self, handle: ServerGoalHandle, motion: Motion) -> None:
        """Raise MotionError if a move cannot or must not continue."""
        if handle.is_cancel_requested:
            raise MotionError("canceled")
        self.links.check(motion)
        connected = bool(self.links.node.count_clients(RESULT_SERVICE))
        if reason := self.client.lost_reason(time.monotonic(), connected):
            raise MotionError(reason)

    def is_reached(self, move: Move) -> bool:
        """Return True if all joints are at their goals and at rest."""
        s = self.links.settings
        return all(
            abs(self.links.states[i].q - part.target) <= s.tolerance
            and abs(self.links.states[i].qd) <= s.motion_threshold
            for i, part in enumerate(move.profiles, 1)
        )

    def describe_farthest(self, move: Move) -> str:
        """Describe the joint that is farthest from its goal."""
        off = [abs(q - p.target) for q, p in zip(self.links.q(), move.profiles, strict=True)]
        return f"joint {off.index(max(off)) + 1} is off by {degrees(max(off)):.2f} deg"


def position(part: Profile) -> LinkCommand:
    """Convert one joint's part of a move to a command."""
    return LinkCommand(
        mode=LinkCommand.POSITION,
        set_point=part.target,
        max_velocity=part.velocity,
        max_acceleration=part.acceleration,
    )
