"""Node `guidance`: runs one activity at a time, from actions to commands for base and arm.

It stops the running activity, with valves closed and joints at rest, on base/stop and arm/stop, and
when the base or the joints are no longer known. If the node itself dies, its last commands to
control and arm expire.
"""

import sys
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Float64
from trajectory_msgs.msg import MultiDOFJointTrajectory

from fss_arm_model.description_file import described
from fss_arm_msgs.msg import GripperState, MassProperties, MissionState, ThrusterHealth
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import COMMAND, LATCHED, command, subscribe_sensor
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe
from fss_gnc import messages
from fss_gnc.guidance import capture
from fss_gnc.guidance.activity import (
    Activity,
    ActivityError,
    Commands,
    Craft,
    Floats,
    HeldBody,
    Observation,
    Outcome,
)
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.kinds import KINDS, Kind
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.latest import Latest
from fss_gnc.programs import guidance as main
from fss_gnc.reference import Body

POINT_SPACING = 0.25  # between points of base/trajectory [s]
MAX_PUBLISHED_POSES = 32  # largest number of poses of a path in mission/state
STALE_AFTER = 2.0  # age after which the state of gripper and tank is unknown [s]


@dataclass
class RunningActivity:
    """A running activity."""

    kind: Kind
    handle: ServerGoalHandle
    activity: Activity
    start_time: int  # [ns]
    budget: Budget
    finished: Future = field(default_factory=Future)  # result of the activity
    moves_joints: bool = False  # True once it has commanded the arm
    problem: str = ""  # why it aborts or brakes, after the phase; empty: neither


class GuidanceNode(Node):
    """Run the base/* and mission/* actions, one at a time."""

    def __init__(self, **options: Any) -> None:
        super().__init__("guidance", **options)
        self.settings = s = declare(self, MissionSettings)
        self.craft = Craft(described(s.arm), s)
        # Load the kernels in advance, because that takes long.
        Budget(self.craft).update(resting_observation(self.craft.arm.n))
        capture.load_kernels(self.craft)
        self.running: RunningActivity | None = None
        self.base = Latest[Body]("base/state", s.max_age)
        self.target = Latest[Body]("target/state", s.max_age)
        self.joints = Latest[Floats]("arm/joint_states", s.max_age)
        self.held_body: HeldBody | None = None  # held body as estimated by the navigation
        self.valves = ThrusterHealth()
        self.holds = Latest[bool]("gripper/state", STALE_AFTER)
        self.propellant = Latest[float]("base/propellant", STALE_AFTER)
        self.polled = [
            PolledSubscription(self, Odometry, topic.name, partial(self.on_body, topic))
            for topic in (self.base, self.target)
        ]
        subscribe_sensor(self, JointState, self.joints.name, self.on_joints)
        subscribe_sensor(self, GripperState, self.holds.name, self.on_gripper)
        subscribe_sensor(self, MassProperties, "target/mass_properties", self.on_mass)
        subscribe_sensor(self, Float64, self.propellant.name, self.on_propellant)
        subscribe(self, ThrusterHealth, "thrusters/health", self.on_valves, LATCHED)
        for name in ("base/stop", "arm/stop"):
            self.create_subscription(Empty, name, partial(self.on_stop, name), 10)
        expiring = command(0.5)
        self.trajectory = self.create_publisher(
            MultiDOFJointTrajectory, "base/trajectory", expiring
        )
        self.joint_commands = self.create_publisher(JointState, "arm/joint_commands", expiring)
        self.gripper = self.create_publisher(Bool, "gripper/command", COMMAND)
        self.state = self.create_publisher(MissionState, "mission/state", LATCHED)
        group = ReentrantCallbackGroup()  # activities take long; other callbacks must run meanwhile
        self.servers = [
            ActionServer(
                self, kind.action, kind.name, partial(self.on_execute, kind),
                cancel_callback=lambda _: CancelResponse.ACCEPT, callback_group=group,
            )
            for kind in KINDS
        ]  # fmt: skip
        self.state.publish(self.mission_state(None, Commands("idle")))
        self.create_timer(1.0 / s.rate, self.tick, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health)

    def close(self) -> None:
        """Destroy the action servers, which the node does not destroy by itself."""
        for server in self.servers:
            server.destroy()

    def now(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def poll_states(self) -> None:
        """Poll the states of base and target."""
        for subscription in self.polled:
            subscription.poll()

    def on_body(self, topic: Latest[Body], message: Odometry) -> None:
        """Store the state of base or target; reject it if it is not finite."""
        try:
            topic.store(stamp_ns(message.header.stamp), messages.body(message))
        except ValueError as error:
            self.get_logger().warning(f"{topic.name}: {error}", throttle_duration_sec=1.0)

    def on_joints(self, message: JointState) -> None:
        """Store the state of all joints."""
        try:
            values = messages.joints(message, self.craft.arm.n)
            self.joints.store(stamp_ns(message.header.stamp), values)
        except ValueError as error:
            self.get_logger().warning(f"arm/joint_states: {error}", throttle_duration_sec=1.0)

    def on_gripper(self, message: GripperState) -> None:
        """Store whether the gripper holds the target."""
        self.holds.store(self.now(), message.holds)
        self.held_body = self.held_body if message.holds else None

    def on_mass(self, message: MassProperties) -> None:
        """Store the mass properties of the held target."""
        try:
            self.held_body = messages.mass_properties(message) if self.holds.value else None
        except ValueError as error:
            text = f"target/mass_properties: {error}"
            self.get_logger().warning(text, throttle_duration_sec=1.0)

    def on_valves(self, message: ThrusterHealth) -> None:
        """Store the health of the valves."""
        self.valves = message

    def on_propellant(self, message: Float64) -> None:
        """Store the remaining propellant."""
        self.propellant.store(self.now(), message.data)

    def on_stop(self, name: str, _: Empty) -> None:
        """End the running activity at once."""
        if self.running:
            self.finish(self.running, Outcome(False, f"stopped by {name}"))

    def observe(self, start_time: int) -> Observation:
        """Return what is known now, with base, target and joints extrapolated to the present."""
        self.poll_states()
        now = self.now()

        def extrapolated(topic: Latest[Body]) -> Body | None:
            values = topic.valid_value(now)
            return values and values.extrapolate(topic.age(now))

        joints, propellant = self.joints.valid_value(now), self.propellant.valid_value(now)
        q, qd, effort = (None,) * 3 if joints is None else joints
        if q is not None and qd is not None:
            q = q + self.joints.age(now) * qd
        return Observation(
            (now - start_time) / SECOND, extrapolated(self.base), extrapolated(self.target), q, qd,
            effort, self.holds.valid_value(now), np.nan if propellant is None else propellant,
            None if self.joints.value is None else self.joints.value[0], self.held_body,
            tuple((np.flatnonzero(self.valves.stuck_open) + 1).tolist()), self.valves.pushed,
        )  # fmt: skip

    def state_problem(self) -> str:
        """Return why base or joints are unknown; empty if both are known."""
        self.poll_states()
        now = self.now()
        return self.base.problem(now) or self.joints.problem(now)

    async def on_execute(self, kind: Kind, handle: ServerGoalHandle) -> Any:
        """Start the activity of a goal and wait for its end; abort a goal that is rejected."""
        try:
            running = self.start(kind, handle)
        except ActivityError as error:
            self.get_logger().warning(f"{kind.name} rejected: {error}")
            handle.abort()
            return kind.action.Result(message=str(error))
        outcome = await running.finished
        if handle.is_cancel_requested:
            handle.canceled()
        elif outcome.success:
            handle.succeed()
        else:
            handle.abort()
        fields = kind.result(running.activity, running.budget, outcome)
        return kind.action.Result(message=outcome.message, **fields)

    def start(self, kind: Kind, handle: ServerGoalHandle) -> RunningActivity:
        """Start an activity; it replaces one that it preempts.

        Raises:
            ActivityError: it cannot start; the running activity continues.
        """
        other = self.running
        if other and not other.kind.name.startswith(kind.preempts):
            raise ActivityError(f"{other.kind.name} is running, cancel it first")
        start_time = self.now()
        obs, problem = self.observe(start_time), self.state_problem()
        try:
            activity = kind.start(self.craft, obs, handle.request)
        except ValueError as error:
            raise ActivityError(problem or str(error)) from None
        if other:
            self.finish(other, Outcome(False, f"preempted by {kind.name}"), coast=False)
        self.running = RunningActivity(kind, handle, activity, start_time, Budget(self.craft))
        self.get_logger().info(f"{kind.name} started")
        return self.running

    def tick(self) -> None:
        """Step the running activity."""
        if not (running := self.running):
            return
        obs = self.observe(running.start_time)
        running.budget.update(obs)
        commands = self.step(running, obs)
        if commands.outcome:
            self.finish(running, commands.outcome)
            return
        self.publish_commands(running, commands, obs)
        running.handle.publish_feedback(
            running.kind.action.Feedback(**running.kind.feedback(running.activity, commands))
        )

    def step(self, running: RunningActivity, obs: Observation) -> Commands:
        """Return an activity's commands; abort it if it cannot continue."""
        if obs.t < 0.0:
            return Commands("abort", outcome=Outcome(False, "the clock jumped back"))
        if running.handle.is_cancel_requested:
            running.activity.cancel("cancelled")
        if not running.activity.tolerates_unknown_state and (problem := self.state_problem()):
            return Commands("abort", outcome=Outcome(False, problem))
        try:
            return running.activity.step(obs)
        except ActivityError as error:
            return Commands("abort", outcome=Outcome(False, str(error)))

    def publish_commands(
        self, running: RunningActivity, commands: Commands, obs: Observation
    ) -> None:
        """Publish the commands of an activity."""
        now, problem = self.now(), commands.reason and f"{commands.phase}: {commands.reason}"
        if problem not in ("", running.problem):
            self.get_logger().warning(f"{running.kind.name}: {problem}")
        running.problem = problem
        self.trajectory.publish(
            messages.trajectory(commands.path, obs.t, now, self.settings.horizon, POINT_SPACING)
        )
        if commands.rates is not None:
            running.moves_joints = True
            self.joint_commands.publish(self.joint_command(commands.rates, now))
        if commands.close_gripper is not None:
            self.gripper.publish(Bool(data=commands.close_gripper))
        self.state.publish(self.mission_state(running, commands))

    def finish(self, running: RunningActivity, outcome: Outcome, coast: bool = True) -> None:
        """End an activity: close the valves and stop the joints, unless another follows."""
        self.running = None
        now = self.now()
        if coast:
            self.trajectory.publish(messages.trajectory(None, 0.0, now, 0.0, POINT_SPACING))
        if coast and running.moves_joints:
            self.joint_commands.publish(self.joint_command(np.zeros(self.craft.arm.n), now))
        phase = "done" if outcome.success else "abort"
        self.state.publish(self.mission_state(running, Commands(phase, outcome=outcome)))
        if outcome.success:
            self.get_logger().info(f"{running.kind.name} succeeded")
        else:
            self.get_logger().warning(f"{running.kind.name} failed: {outcome.message}")
        running.finished.set_result(outcome)

    def joint_command(self, rates: Floats, now: int) -> JointState:
        """Return rates of all joints [rad/s] as a command."""
        names = [f"joint_{i + 1}" for i in range(len(rates))]
        message = JointState(name=names, velocity=np.asarray(rates, dtype=float).tolist())
        message.header.stamp = to_time(now)
        return message

    def mission_state(self, running: RunningActivity | None, commands: Commands) -> MissionState:
        """Return the state of the mission, and the resources that it has used."""
        budget = running.budget if running else Budget(self.craft)
        reason = commands.outcome.message if commands.outcome else commands.reason
        state = MissionState(
            mission=running.kind.name.partition("/")[2] if running else "",
            phase=commands.phase, reason=reason,
            elapsed=budget.elapsed, reference=np.full(3, np.nan),
            keep_out=commands.keep_out, fixture_distance=commands.fixture_distance,
            edge_clearance=budget.edge_gap, target_clearance=budget.target_gap,
            propellant=budget.propellant, momentum=budget.momentum,
            largest_torque=budget.largest_torque,
        )  # fmt: skip
        state.header.stamp, state.header.frame_id = to_time(self.now()), "world"
        if commands.path is not None:
            path = commands.path.sample(budget.elapsed, MAX_PUBLISHED_POSES)[1]
            state.reference, state.path = path[0, 0], path[:, 0].ravel().tolist()
        return state

    def health(self) -> Health:
        """Return the health for diagnostics."""
        if running := self.running:
            text = ": ".join(filter(None, (running.kind.name, running.problem)))
            return Health(WARN if running.problem else OK, text)
        problem = self.state_problem()
        return Health(WARN if problem else OK, problem or "ready")


def resting_observation(n: int) -> Observation:
    """Return a state of base, target and n joints, all zero and at rest."""
    body, zero = Body(np.zeros(3), np.zeros(3)), np.zeros(n)
    return Observation(0.0, body, body, zero, zero)


if __name__ == "__main__":
    sys.exit(main())
