"""Node `guidance`: runs one activity at a time, from actions to commands for base and arm.

It ends the running activity, with valves closed and joints at rest, on base/stop and arm/stop, and
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
    Craft,
    Ended,
    Floats,
    Held,
    Orders,
    Seen,
)
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.kinds import KINDS, Kind
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.latest import Latest
from fss_gnc.programs import guidance as main
from fss_gnc.reference import Body

STEP = 0.25  # between points of base/trajectory [s]
PICTURED = 32  # largest number of poses of a path in mission/state
FORGETFUL = 2.0  # age after which the state of gripper and tank is unknown [s]


@dataclass
class Flight:
    """A running activity."""

    kind: Kind
    handle: ServerGoalHandle
    activity: Activity
    begun: int  # [ns]
    budget: Budget
    over: Future = field(default_factory=Future)  # result of the activity
    rates: bool = False  # True once it has commanded the arm
    trouble: str = ""  # why it aborts or brakes, after the phase; empty: neither


class GuidanceNode(Node):
    """Run the base/* and mission/* actions, one at a time."""

    def __init__(self, **options: Any) -> None:
        super().__init__("guidance", **options)
        self.settings = s = declare(self, MissionSettings)
        self.craft = Craft(described(s.arm), s)
        Budget(self.craft).update(at_rest(self.craft.arm.n))  # loads the kernels, which takes long
        capture.load(self.craft)
        self.flight: Flight | None = None
        self.base = Latest[Body]("base/state", s.max_age)
        self.target = Latest[Body]("target/state", s.max_age)
        self.joints = Latest[Floats]("arm/joint_states", s.max_age)
        self.held: Held | None = None  # held body as estimated by the navigation
        self.valves = ThrusterHealth()
        self.holds = Latest[bool]("gripper/state", FORGETFUL)
        self.propellant = Latest[float]("base/propellant", FORGETFUL)
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
        lives = command(0.5)
        self.trajectory = self.create_publisher(MultiDOFJointTrajectory, "base/trajectory", lives)
        self.rates = self.create_publisher(JointState, "arm/joint_commands", lives)
        self.grip = self.create_publisher(Bool, "gripper/command", COMMAND)
        self.state = self.create_publisher(MissionState, "mission/state", LATCHED)
        group = ReentrantCallbackGroup()  # activities take long; other callbacks must run meanwhile
        self.servers = [
            ActionServer(
                self, kind.action, kind.name, partial(self.on_execute, kind),
                cancel_callback=lambda _: CancelResponse.ACCEPT, callback_group=group,
            )
            for kind in KINDS
        ]  # fmt: skip
        self.state.publish(self.mission(None, Orders("idle")))
        self.create_timer(1.0 / s.rate, self.tick, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health)

    def close(self) -> None:
        """Destroy the action servers, which the node does not destroy by itself."""
        for server in self.servers:
            server.destroy()

    def now(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def look(self) -> None:
        """Poll the states of base and target."""
        for subscription in self.polled:
            subscription.poll()

    def on_body(self, topic: Latest[Body], message: Odometry) -> None:
        """Store the state of base or target; reject it if it is not finite."""
        try:
            topic.take(stamp_ns(message.header.stamp), messages.body(message))
        except ValueError as error:
            self.get_logger().warning(f"{topic.name}: {error}", throttle_duration_sec=1.0)

    def on_joints(self, message: JointState) -> None:
        """Store the state of all joints."""
        try:
            found = messages.joints(message, self.craft.arm.n)
            self.joints.take(stamp_ns(message.header.stamp), found)
        except ValueError as error:
            self.get_logger().warning(f"arm/joint_states: {error}", throttle_duration_sec=1.0)

    def on_gripper(self, message: GripperState) -> None:
        """Store whether the gripper holds the target."""
        self.holds.take(self.now(), message.holds)
        self.held = self.held if message.holds else None

    def on_mass(self, message: MassProperties) -> None:
        """Store the mass properties of the held target."""
        try:
            self.held = messages.mass_properties(message) if self.holds.value else None
        except ValueError as error:
            words = f"target/mass_properties: {error}"
            self.get_logger().warning(words, throttle_duration_sec=1.0)

    def on_valves(self, message: ThrusterHealth) -> None:
        """Store the health of the valves."""
        self.valves = message

    def on_propellant(self, message: Float64) -> None:
        """Store the remaining propellant."""
        self.propellant.take(self.now(), message.data)

    def on_stop(self, name: str, _: Empty) -> None:
        """End the running activity at once."""
        if self.flight:
            self.end(self.flight, Ended(False, f"stopped by {name}"))

    def seen(self, begun: int) -> Seen:
        """Return what is known now, with base, target and joints extrapolated to the present."""
        self.look()
        now = self.now()

        def moved(topic: Latest[Body]) -> Body | None:
            found = topic.at(now)
            return found and found.after(topic.age(now))

        joints, left = self.joints.at(now), self.propellant.at(now)
        q, qd, effort = (None,) * 3 if joints is None else joints
        if q is not None and qd is not None:
            q = q + self.joints.age(now) * qd
        return Seen(
            (now - begun) / SECOND, moved(self.base), moved(self.target), q, qd, effort,
            self.holds.at(now), np.nan if left is None else left,
            None if self.joints.value is None else self.joints.value[0], self.held,
            tuple((np.flatnonzero(self.valves.stuck_open) + 1).tolist()), self.valves.pushed,
        )  # fmt: skip

    def trouble(self) -> str:
        """Return why base or joints are unknown; empty if both are known."""
        self.look()
        now = self.now()
        return self.base.trouble(now) or self.joints.trouble(now)

    async def on_execute(self, kind: Kind, handle: ServerGoalHandle) -> Any:
        """Start the activity of a goal and wait for its end; abort a goal that is rejected."""
        try:
            flight = self.begin(kind, handle)
        except ActivityError as error:
            self.get_logger().warning(f"{kind.name} refused: {error}")
            handle.abort()
            return kind.action.Result(message=str(error))
        ended = await flight.over
        if handle.is_cancel_requested:
            handle.canceled()
        elif ended.well:
            handle.succeed()
        else:
            handle.abort()
        fields = kind.result(flight.activity, flight.budget, ended)
        return kind.action.Result(message=ended.message, **fields)

    def begin(self, kind: Kind, handle: ServerGoalHandle) -> Flight:
        """Start an activity; it replaces one that it preempts.

        Raises:
            ActivityError: it cannot start; the running activity continues.
        """
        other = self.flight
        if other and not other.kind.name.startswith(kind.preempts):
            raise ActivityError(f"{other.kind.name} is under way")
        begun = self.now()
        seen, trouble = self.seen(begun), self.trouble()
        try:
            activity = kind.begin(self.craft, seen, handle.request)
        except ValueError as error:
            raise ActivityError(trouble or str(error)) from None
        if other:
            self.end(other, Ended(False, f"preempted by {kind.name}"), coast=False)
        self.flight = Flight(kind, handle, activity, begun, Budget(self.craft))
        self.get_logger().info(f"{kind.name} begins")
        return self.flight

    def tick(self) -> None:
        """Step the running activity."""
        if not (flight := self.flight):
            return
        seen = self.seen(flight.begun)
        flight.budget.update(seen)
        orders = self.step(flight, seen)
        if orders.ended:
            self.end(flight, orders.ended)
            return
        self.order(flight, orders, seen)
        flight.handle.publish_feedback(
            flight.kind.action.Feedback(**flight.kind.feedback(flight.activity, orders))
        )

    def step(self, flight: Flight, seen: Seen) -> Orders:
        """Return an activity's orders; its end if it cannot continue."""
        if seen.t < 0.0:
            return Orders("abort", ended=Ended(False, "the clock was set back"))
        if flight.handle.is_cancel_requested:
            flight.activity.cancel("cancelled")
        if not flight.activity.blind and (why := self.trouble()):
            return Orders("abort", ended=Ended(False, why))
        try:
            return flight.activity.step(seen)
        except ActivityError as error:
            return Orders("abort", ended=Ended(False, str(error)))

    def order(self, flight: Flight, orders: Orders, seen: Seen) -> None:
        """Publish the commands of an activity."""
        now, trouble = self.now(), orders.reason and f"{orders.phase}: {orders.reason}"
        if trouble not in ("", flight.trouble):
            self.get_logger().warning(f"{flight.kind.name}, {trouble}")
        flight.trouble = trouble
        self.trajectory.publish(
            messages.trajectory(orders.path, seen.t, now, self.settings.horizon, STEP)
        )
        if orders.rates is not None:
            flight.rates = True
            self.rates.publish(self.joint_rates(orders.rates, now))
        if orders.close is not None:
            self.grip.publish(Bool(data=orders.close))
        self.state.publish(self.mission(flight, orders))

    def end(self, flight: Flight, ended: Ended, coast: bool = True) -> None:
        """End an activity: close the valves and stop the joints, unless another follows."""
        self.flight = None
        now = self.now()
        if coast:
            self.trajectory.publish(messages.trajectory(None, 0.0, now, 0.0, STEP))
        if coast and flight.rates:
            self.rates.publish(self.joint_rates(np.zeros(self.craft.arm.n), now))
        phase = "done" if ended.well else "abort"
        self.state.publish(self.mission(flight, Orders(phase, ended=ended)))
        if ended.well:
            self.get_logger().info(f"{flight.kind.name} ended")
        else:
            self.get_logger().warning(f"{flight.kind.name} ended: {ended.message}")
        flight.over.set_result(ended)

    def joint_rates(self, rates: Floats, now: int) -> JointState:
        """Return rates of all joints [rad/s] as a command."""
        names = [f"joint_{i + 1}" for i in range(len(rates))]
        message = JointState(name=names, velocity=np.asarray(rates, dtype=float).tolist())
        message.header.stamp = to_time(now)
        return message

    def mission(self, flight: Flight | None, orders: Orders) -> MissionState:
        """Return the state of the mission, and the resources that it has used."""
        budget = flight.budget if flight else Budget(self.craft)
        state = MissionState(
            mission=flight.kind.name.partition("/")[2] if flight else "",
            phase=orders.phase, reason=orders.ended.message if orders.ended else orders.reason,
            elapsed=budget.elapsed, reference=np.full(3, np.nan),
            keep_out=orders.keep_out, fixture_distance=orders.fixture_distance,
            edge_clearance=budget.edge, target_clearance=budget.target,
            propellant=budget.propellant, momentum=budget.momentum,
            largest_torque=budget.largest_torque,
        )  # fmt: skip
        state.header.stamp, state.header.frame_id = to_time(self.now()), "world"
        if orders.path is not None:
            ahead = orders.path.sampled(budget.elapsed, PICTURED)[1]
            state.reference, state.path = ahead[0, 0], ahead[:, 0].ravel().tolist()
        return state

    def health(self) -> Health:
        """Return the health for diagnostics."""
        if flight := self.flight:
            words = ", ".join(filter(None, (flight.kind.name, flight.trouble)))
            return Health(WARN if flight.trouble else OK, words)
        why = self.trouble()
        return Health(WARN if why else OK, why or "ready")


def at_rest(n: int) -> Seen:
    """Return a state of base, target and n joints, all zero and at rest."""
    body, zero = Body(np.zeros(3), np.zeros(3)), np.zeros(n)
    return Seen(0.0, body, body, zero, zero)


if __name__ == "__main__":
    sys.exit(main())
