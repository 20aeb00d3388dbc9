"""The node of the whole arm: its state, the ways to move it, and one answer for all links."""

import sys
from collections.abc import Mapping
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from fss_arm_driver.arm.guard_topics import GuardTopics
from fss_arm_driver.arm.link_topics import LinkTopics, Take, in_words
from fss_arm_driver.arm.move_action import MoveAction
from fss_arm_driver.arm.state_topics import StateTopics
from fss_arm_driver.arm.stream_topic import StreamTopic
from fss_arm_driver.arm.trajectory_action import TrajectoryAction
from fss_arm_driver.programs import arm as main
from fss_arm_driver.settings import ArmSettings
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import subscribe_stop

ANSWER = 6.0  # a link's driver has answered by then [s]
HEARTBEAT = 0.5  # of diagnostics: at most 1 s old, even while a long goal is planned [s]


class ArmNode(Node):
    """Says what all joints do, moves them by moves, trajectories and streams, arms the links.

    Args:
        kind: ArmSettings, or more than these.
        local: what takes commands of links whose drivers are in this process, by number.
    """

    def __init__(
        self,
        kind: type[ArmSettings] = ArmSettings,
        local: Mapping[int, Take] | None = None,
        **options: Any,
    ) -> None:
        super().__init__("arm", **options)
        self.settings = declare(self, kind)
        self.links = LinkTopics(self, self.settings.description(), self.settings, local)
        self.states = StateTopics(self.links)
        self.guard = GuardTopics(self, self.links.arm, self.settings)
        self.moves = MoveAction(self.links, self.guard)
        self.trajectories = TrajectoryAction(self.links, self.guard)
        self.streams = StreamTopic(self.links, self.guard)
        subscribe_stop(self, "arm/stop", lambda _: self.links.stop())
        waits = ReentrantCallbackGroup()  # answers take their time; all else goes on
        self.armers = [
            self.create_client(SetBool, f"link_{i}/arm", callback_group=waits)
            for i in self.links.numbers
        ]
        self.create_service(SetBool, "arm/enable", self.on_arm, callback_group=waits)
        self.create_timer(1.0 / self.settings.rate, self.tick, clock=self.links.clock)
        self.diagnostics = Diagnostics(self, self.health, period=HEARTBEAT)

    def close(self) -> None:
        """Give back what a node does not destroy by itself."""
        self.streams.close()
        self.moves.server.destroy()
        self.trajectories.close()

    def tick(self) -> None:
        """See where base and target are, and let a motion under way go on."""
        self.guard.look()
        self.links.tick()

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Pass the request on to all links at once; succeed if all do. An old one arms nothing."""
        if request.data and (old := self.links.interruption()):
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
        response.message = "; ".join(texts) or f"all {len(self.armers)} links are {words}"
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
        links, stream = self.links, self.streams.stream
        troubles = links.troubles()
        values: dict[str, Any] = {f"link {i}": troubles.get(i, "armed") for i in links.numbers}
        values["arm/joint_states"] = self.states.withheld or "published"
        values["guarded against"] = self.guard.words()
        values["path"] = links.path
        values["commands taken"] = stream.taken
        values |= {f"commands refused: {kind}": n for kind, n in sorted(stream.refused.items())}
        if troubles:
            return Health(WARN, in_words(troubles), values)
        if why := self.states.withheld:
            return Health(WARN, f"no arm/joint_states: {why}", values)
        return Health(OK, links.arbiter.holder(links.now()) or "ready", values)


if __name__ == "__main__":
    sys.exit(main())
