"""Node `guidance`: runs one activity at a time, from actions to commands for base and arm.

It stops the running activity, with valves closed and joints at rest, on base/stop and arm/stop, and
when the base or, for longer, the joints are no longer known. If the node itself dies, its last
commands to control and arm expire.
"""

import sys
from collections.abc import Iterable
from functools import partial
from itertools import product
from typing import Any, NamedTuple

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Empty

from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.events import report
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import STOPS
from fss_arm_ros.timers import timer_clock
from fss_arm_ros.timing import Timing
from fss_gnc import guidance_topics as topics
from fss_gnc.guidance import capture
from fss_gnc.guidance.activity import ActivityError, Craft, Observation, Outcome
from fss_gnc.guidance.execution import Execution, Kind, start_activity
from fss_gnc.guidance.kinds import KINDS
from fss_gnc.guidance.measurements import Measurements
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.programs import guidance as main
from fss_gnc.vehicle_topics import VehicleTopics


class Running(NamedTuple):
    """A running activity and its goal."""

    execution: Execution
    handle: ServerGoalHandle
    finished: Future  # outcome of the activity


class GuidanceNode(Node):
    """Run the base/* and mission/* actions, one at a time."""

    def __init__(self, **options: Any) -> None:
        super().__init__("guidance", **options)
        self.settings = s = declare(self, MissionSettings)
        self.craft = Craft(load_described_arm(self, s.arm), s)
        capture.load_kernels(self.craft)
        self.running: Running | None = None
        self.timing = Timing(s.rate, self)
        self.measured = Measurements(self.craft.arm.n, s.max_age)
        self.vehicles = VehicleTopics(self, self.craft)
        self.polled = topics.subscribe_to_states(self, self.on_message)
        for name, qos in product(("base/stop", "arm/stop"), STOPS):
            self.create_subscription(Empty, name, partial(self.on_stop, name), qos)
        self.outputs = {
            name: self.create_publisher(kind, name, qos)
            for name, (kind, qos) in topics.OUTPUTS.items()
        }
        group = ReentrantCallbackGroup()  # activities take long; other callbacks must run meanwhile
        options = {"callback_group": group, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        self.servers = [
            ActionServer(self, kind.action, kind.name, partial(self.on_execute, kind), **options)
            for kind in KINDS
        ]
        self.publish(topics.idle_messages(self.craft, self.now()))
        self.create_timer(1.0 / s.rate, self.tick, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health, timing=self.timing)
        actions = ", ".join(kind.name for kind in KINDS)
        self.get_logger().info(f"ready for {actions} (joints: {self.craft.arm.n})")

    def close(self) -> None:
        """Destroy the action servers, which the node does not destroy by itself."""
        for server in self.servers:
            server.destroy()

    def now(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def on_message(self, topic: str, store: topics.Store, message: Any) -> None:
        """Store a message; reject it if it is invalid."""
        try:
            store(self.measured, message, self.now())
        except ValueError as error:
            self.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=1.0)

    def publish(self, outputs: Iterable[tuple[str, Any]]) -> None:
        """Publish messages on their topics."""
        for name, message in outputs:
            self.outputs[name].publish(message)

    def on_stop(self, name: str, _: Empty) -> None:
        """End the running activity at once."""
        if self.running:
            self.finish(self.running, Outcome(False, f"stopped by {name}"))

    def observe(self, start_time: int = 0) -> tuple[Observation, str]:
        """Return what is known now, and why base or joints are unknown (empty: both are known)."""
        for subscription in self.polled:
            subscription.poll()
        now = self.now()
        others = self.vehicles.observe(now)
        return self.measured.observe(now, start_time, others), self.measured.problem(now)

    async def on_execute(self, kind: Kind, handle: ServerGoalHandle) -> Any:
        """Start the activity of a goal and wait for its end; abort a goal that is rejected."""
        other, now = self.running, self.now()
        obs, problem = self.observe(now)
        try:
            before = other and other.execution.kind
            execution = start_activity(
                kind, self.craft, handle.request, obs, now, problem=problem, running=before
            )
        except ActivityError as error:
            self.get_logger().warning(f"{kind.name} rejected: {error}")
            handle.abort()
            return kind.action.Result(message=str(error))
        if other:
            self.finish(other, Outcome(False, f"preempted by {kind.name}"), coast=False)
        running = self.running = Running(execution, handle, Future())
        self.get_logger().info(f"{kind.name} started")
        outcome = await running.finished
        if handle.is_cancel_requested:
            handle.canceled()
        elif outcome.success:
            handle.succeed()
        else:
            handle.abort()
        return execution.result(outcome)

    def tick(self) -> None:
        """Step the running activity."""
        if not (running := self.running):
            self.timing.interrupt()
            if self.vehicles.tracks:
                self.vehicles.announce(None, self.observe()[0], self.now())
            return
        self.timing.add_step()
        execution, handle, _ = running
        obs, problem = self.observe(execution.start_time)
        commands = execution.step(obs, handle.is_cancel_requested, problem)
        if commands.outcome:
            self.finish(running, commands.outcome)
            return
        report(self, execution.log_lines(commands))
        now, horizon = self.now(), self.settings.horizon
        self.publish(topics.command_messages(execution, commands, obs.t, horizon, now))
        self.vehicles.announce(commands, obs, now)
        self.timing.add_command(self.measured.base.stamp)
        handle.publish_feedback(execution.feedback(commands))

    def finish(self, running: Running, outcome: Outcome, coast: bool = True) -> None:
        """End an activity: close the valves and stop the joints, unless another follows."""
        self.running = None
        execution, n = running.execution, self.craft.arm.n
        self.publish(topics.end_messages(execution, outcome, n, self.now(), coast=coast))
        if outcome.success:
            self.get_logger().info(f"{execution.kind.name} succeeded")
        else:
            self.get_logger().warning(f"{execution.kind.name} failed: {outcome.message}")
        running.finished.set_result(outcome)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        if self.running:
            execution = self.running.execution
            return Health(WARN if execution.problem else OK, execution.status)
        problem = self.observe()[1] or self.vehicles.problem()
        return Health(WARN if problem else OK, problem or "ready")


if __name__ == "__main__":
    sys.exit(main())
