"""The node of the whole arm: moves of all joints together, and one answer for all links."""

import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from rclpy.time import Time
from std_msgs.msg import Empty, String
from std_srvs.srv import SetBool
from unique_identifier_msgs.msg import UUID

from fss_arm_driver.move import MAX_DURATION, Move, MoveError, Profile, plan
from fss_arm_driver.protocol import State
from fss_arm_driver.scale import Scale
from fss_arm_driver.settings import ArmSettings
from fss_arm_driver.watch import Asker, Stall
from fss_arm_model.urdf import urdf
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.pace import pace
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, command, subscribe_sensor
from fss_arm_ros.run import run

ANSWER = 6.0  # a link's driver has answered by then [s]
ASKING = "arm/move/_action/get_result"  # the service that whoever asked for a move is a client of


@dataclass(frozen=True)
class LinkState:
    """What one link reported last."""

    heard: int  # [ns]
    q: float  # [rad]
    qd: float  # [rad/s]
    armed: bool
    referenced: bool


class ArmNode(Node):
    """Moves all joints to given angles so that they arrive together; arms and disarms all links."""

    def __init__(self, **options: Any) -> None:
        super().__init__("arm", **options)
        self.settings = declare(self, ArmSettings)
        self.arm = self.settings.description()
        self.numbers = range(1, self.arm.n + 1)
        self.links: dict[int, LinkState] = {}
        self.moving, self.stopped = b"", False  # the goal's id
        self.asker = Asker(0.0, 0.0)
        self.clock, self.stall = pace(self), Stall(self.settings.time_to_live)
        self.ticked: Future = Future()

        lifespan = command(self.settings.time_to_live)
        self.commands = [
            self.create_publisher(LinkCommand, f"link_{i}/command", lifespan) for i in self.numbers
        ]
        waits = ReentrantCallbackGroup()  # moves and answers take their time; all else goes on
        self.armers = [
            self.create_client(SetBool, f"link_{i}/arm", callback_group=waits) for i in self.numbers
        ]
        for i, link in enumerate(self.arm.links, 1):
            self.listen(i, Scale(link))
        self.create_subscription(Empty, "arm/stop", self.on_stop, 10)
        self.create_subscription(UUID, "arm/move/alive", self.on_alive, 10)
        self.create_service(SetBool, "arm/enable", self.on_arm, callback_group=waits)
        description = self.create_publisher(String, "robot_description", LATCHED)
        description.publish(String(data=urdf(self.arm)))
        self.create_timer(1.0 / self.settings.rate, self.tick, clock=self.clock)
        self.mover = ActionServer(
            self,
            MoveArm,
            "arm/move",
            self.on_move,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=waits,
        )
        self.diagnostics = Diagnostics(self, self.health)

    def listen(self, number: int, scale: Scale) -> None:
        """Keep the state of one link."""

        def take(message: LinkTelemetry) -> None:
            q, qd = scale.position(message.position), scale.velocity(message.velocity)
            referenced = bool(message.flags & State.REFERENCED)
            self.links[number] = LinkState(self.now(), q, qd, message.armed, referenced)

        subscribe_sensor(self, LinkTelemetry, f"link_{number}/telemetry", take)

    def now(self) -> int:
        """The node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def stood_still(self) -> str:
        """That this process did, for longer than a command lives; what it hears now may be old."""
        return self.stall.check(1e-9 * self.clock.now().nanoseconds)

    def tick(self) -> None:
        """Let a move under way go on."""
        self.stood_still()
        self.ticked, ticked = Future(), self.ticked
        ticked.set_result(None)

    def on_stop(self, _: Empty) -> None:
        """The links' drivers stop by themselves; a move ends."""
        self.stopped = True

    def on_alive(self, goal: UUID) -> None:
        """Whoever asked for a move still wants it."""
        if goal.uuid.tobytes() == self.moving:
            self.asker.heard = time.monotonic()

    async def on_move(self, handle: ServerGoalHandle) -> MoveArm.Result:
        """Execute `arm/move`."""
        message = ""
        try:
            await self.move(handle)
        except MoveError as error:
            message = str(error)
        if not message:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            self.get_logger().warning(f"move ended: {message}")
            handle.abort()
        return MoveArm.Result(reached=not message, message=message, q=self.q())

    async def move(self, handle: ServerGoalHandle) -> None:
        """Send the links where they shall go until they are there.

        Raises:
            MoveError: it cannot be begun, or ended before.
        """
        if self.moving:
            raise MoveError("another move is under way")
        self.stopped = False
        given = self.check(handle)
        request = handle.request
        move, begun = plan(self.arm, self.q(), tuple(request.q), request.duration), self.now()
        if not 0.0 <= request.keep_alive <= MAX_DURATION:
            raise MoveError(
                f"keep_alive is {request.keep_alive} s, expected 0 to {MAX_DURATION:.0f}"
            )
        self.moving = handle.goal_id.uuid.tobytes()
        self.asker = Asker(request.keep_alive, time.monotonic())
        try:
            while not self.reached(move):
                elapsed = (self.now() - begun) / SECOND
                if elapsed > move.duration + self.settings.max_overrun:
                    raise MoveError(f"not reached within {elapsed:.1f} s, {self.farthest(move)}")
                self.send(map(position, move.profiles), given)
                remaining = max(0.0, move.duration - elapsed)
                handle.publish_feedback(MoveArm.Feedback(q=self.q(), remaining=remaining))
                await self.ticked
                given = self.check(handle)
                if gone := self.asker.gone(time.monotonic(), bool(self.count_clients(ASKING))):
                    raise MoveError(gone)
        except MoveError:
            if not self.stopped:
                rest = [LinkCommand(mode=LinkCommand.VELOCITY)] * self.arm.n
                self.send(rest, self.get_clock().now())
            raise
        finally:
            self.moving = b""

    def check(self, handle: ServerGoalHandle) -> Time:
        """When the arm could and should move; raise MoveError if it cannot or shall not."""
        given = self.get_clock().now()
        if why := self.stood_still():
            raise MoveError(why)
        if handle.is_cancel_requested:
            raise MoveError("cancelled")
        if self.stopped:
            raise MoveError("stopped")
        for i, trouble in self.troubles().items():
            raise MoveError(f"link {i} {trouble}")
        return given

    def troubles(self) -> dict[int, str]:
        """What keeps each link from moving, if anything does."""
        oldest = self.now() - self.settings.time_to_live * SECOND
        silent = {
            i: "is silent"
            for i in self.numbers
            if i not in self.links or self.links[i].heard < oldest
        }
        states = {i: self.links[i] for i in self.numbers if not silent}
        unknown = {i: "is not referenced" for i, state in states.items() if not state.referenced}
        return silent or unknown or {i: "is not armed" for i, s in states.items() if not s.armed}

    def q(self) -> tuple[float, ...]:
        """Present readings (n) [rad]; () while a link has never been heard."""
        return tuple(self.links[i].q for i in self.numbers if len(self.links) == self.arm.n)

    def reached(self, move: Move) -> bool:
        """Whether all joints are at their goals and at rest."""
        return all(
            abs(self.links[i].q - part.target) <= self.settings.tolerance
            and abs(self.links[i].qd) <= self.settings.motion_threshold
            for i, part in enumerate(move.profiles, 1)
        )

    def farthest(self, move: Move) -> str:
        """The joint that is farthest from its goal, in words."""
        off = [abs(q - part.target) for q, part in zip(self.q(), move.profiles, strict=True)]
        return f"joint {off.index(max(off)) + 1} is off by {max(off):.4f} rad"

    def send(self, messages: Iterable[LinkCommand], given: Time) -> None:
        """Send each link its command, given at that time, from which on it lives."""
        stamp = given.to_msg()
        for publisher, message in zip(self.commands, messages, strict=True):
            message.header.stamp = stamp
            message.time_to_live = self.settings.time_to_live
            publisher.publish(message)

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Pass the request on to all links at once; succeed if all do. An old one arms nothing."""
        if request.data and (old := self.stood_still()):
            response.message = old
            return response
        pending = [self.ask(client, request) for client in self.armers]
        answers = [await answer for answer in pending]
        texts = [
            f"link {i} did not answer" if answer is None else answer.message
            for i, answer in enumerate(answers, 1)
            if answer is None or not answer.success
        ]
        words = "armed" if request.data else "disarmed"
        response.success = not texts
        response.message = "; ".join(texts) or f"all {self.arm.n} links are {words}"
        return response

    def ask(self, client: Any, request: SetBool.Request) -> Future:
        """The answer to a request, or None when it has not come in time or nobody is there."""
        if not client.service_is_ready():
            nobody = Future()
            nobody.set_result(None)
            return nobody
        answer = client.call_async(request)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(ANSWER, answer.cancel, clock=steady)
        answer.add_done_callback(lambda _: self.destroy_timer(timer))
        return answer

    def health(self) -> Health:
        """For diagnostics."""
        troubles = self.troubles()
        values = {f"link {i}": troubles.get(i, "armed") for i in self.numbers}
        if troubles:
            return Health(WARN, "; ".join(f"link {i} {why}" for i, why in troubles.items()), values)
        return Health(OK, "moving" if self.moving else "ready", values)


def position(part: Profile) -> LinkCommand:
    """One joint's part in a move as a command."""
    return LinkCommand(
        mode=LinkCommand.POSITION,
        set_point=part.target,
        max_velocity=part.velocity,
        max_acceleration=part.acceleration,
    )


def main() -> int:
    """Run as `ros2 run fss_arm_driver arm`."""
    return run(ArmNode, ArmSettings)


if __name__ == "__main__":
    sys.exit(main())
