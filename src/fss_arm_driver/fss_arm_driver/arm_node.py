"""Node of the whole arm: its state, its motions, and services for all links."""

import sys
from collections.abc import Mapping
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from fss_arm_driver.arm.guard_topics import GuardTopics
from fss_arm_driver.arm.link_topics import CommandSink, LinkTopics, describe_problems
from fss_arm_driver.arm.move_action import MoveAction
from fss_arm_driver.arm.state_topics import StateTopics
from fss_arm_driver.arm.stream_topic import StreamTopic
from fss_arm_driver.arm.trajectory_action import TrajectoryAction
from fss_arm_driver.programs import arm as main
from fss_arm_driver.settings import ArmSettings
from fss_arm_ros.described_arm import compare_with_joint_states
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare

ANSWER_TIMEOUT = 6.0  # for a link's driver to answer [s]
SIMULATED_ANSWER_TIMEOUT = 30.0  # in simulated time, which may be slow, by real time [s]
HEARTBEAT = 0.5  # period of diagnostics: at most 1 s old, even while a long goal is planned [s]


class ArmNode(Node):
    """Node that publishes all joints, moves them by moves, trajectories and streams, and arms them.

    Args:
        kind: ArmSettings, or a subclass.
        local: callbacks for the commands of links whose drivers are in this process, by number.
    """

    def __init__(
        self,
        kind: type[ArmSettings] = ArmSettings,
        local: Mapping[int, CommandSink] | None = None,
        **options: Any,
    ) -> None:
        super().__init__("arm", **options)
        self.settings = declare(self, kind)
        self.links = LinkTopics(self, self.settings.description(), self.settings, local)
        compare_with_joint_states(self, self.links.arm)
        self.states = StateTopics(self.links)
        self.guard = GuardTopics(self, self.links.arm, self.settings)
        self.moves = MoveAction(self.links, self.guard)
        self.trajectories = TrajectoryAction(self.links, self.guard)
        self.streams = StreamTopic(self.links, self.guard)
        concurrent = ReentrantCallbackGroup()  # other callbacks run while answers are awaited
        self.armers = [
            self.create_client(SetBool, f"link_{i}/arm", callback_group=concurrent)
            for i in self.links.numbers
        ]
        self.create_service(SetBool, "arm/enable", self.on_arm, callback_group=concurrent)
        self.create_timer(1.0 / self.settings.rate, self.tick, clock=self.links.clock)
        self.diagnostics = Diagnostics(self, self.health, period=HEARTBEAT)
        self.get_logger().info(
            "ready for arm/move, arm_controller/follow_joint_trajectory and arm/joint_commands "
            f"(joints: {self.links.arm.n})"
        )

    def close(self) -> None:
        """Release what the node does not destroy by itself."""
        self.streams.close()
        self.moves.server.destroy()
        self.trajectories.close()

    def tick(self) -> None:
        """Receive the poses of base and target, and continue the current motion."""
        self.guard.poll()
        self.links.tick()

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Forward the request to all links; succeed if all do. After a pause nothing is armed."""
        if request.data and (old := self.links.interruption()):
            response.message = old
            return response
        pending = [self.call(client, request) for client in self.armers]
        answers = [await answer for answer in pending]
        texts = [
            f"link {i} did not answer" if answer is None else answer.message
            for i, answer in enumerate(answers, 1)
            if answer is None or not answer.success
        ]
        words = "armed" if request.data else "disarmed"
        response.success = not texts
        response.message = "; ".join(texts) or f"all {len(self.armers)} links are {words}"
        return response

    def call(self, client: Any, request: SetBool.Request) -> Future:
        """Return the future answer to a request: None after a timeout, or if no driver runs."""
        if not client.service_is_ready():
            unavailable = Future()
            unavailable.set_result(None)
            return unavailable
        answer = client.call_async(request)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        simulated = self.get_parameter("use_sim_time").value
        timeout = SIMULATED_ANSWER_TIMEOUT if simulated else ANSWER_TIMEOUT
        timer = self.create_timer(timeout, answer.cancel, clock=steady)
        answer.add_done_callback(lambda _: self.destroy_timer(timer))
        return answer

    def health(self) -> Health:
        """Return the health for diagnostics."""
        links, stream = self.links, self.streams.stream
        problems = links.problems()
        values: dict[str, Any] = {f"link {i}": problems.get(i, "armed") for i in links.numbers}
        values["arm/joint_states"] = self.states.withheld_reason or "published"
        values["bodies kept clear of"] = self.guard.describe_protection()
        values["number of the last path"] = links.path
        values["commands accepted"] = stream.accepted
        values |= {f"commands refused: {kind}": n for kind, n in sorted(stream.refused.items())}
        if problems:
            return Health(WARN, describe_problems(problems), values)
        if why := self.states.withheld_reason:
            return Health(WARN, f"no arm/joint_states: {why}", values)
        motion = links.arbiter.current_name(links.now())
        return Health(OK, f"{motion} is in progress" if motion else "ready", values)


if __name__ == "__main__":
    sys.exit(main())
