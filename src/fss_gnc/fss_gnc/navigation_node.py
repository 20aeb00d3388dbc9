"""Node `navigation`: estimates pose and twist of base and target for all other nodes."""

import sys
from collections import Counter
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory

from fss_arm_msgs.msg import GripperState, MassProperties, ThrusterCommand, ThrusterHealth
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.calibrations import subscribe_calibrations
from fss_arm_ros.convert import SECOND, joint_readings, seen_pose, stamp_ns
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor
from fss_arm_ros.timers import timer_clock
from fss_arm_ros.timing import Timing
from fss_gnc.messages import planned_rates
from fss_gnc.navigation import Navigation, messages
from fss_gnc.navigation.body_filter import BodyState
from fss_gnc.navigation.health import diagnostic_values, find_problems, valve_problems
from fss_gnc.navigation.settings import NavigationSettings
from fss_gnc.navigation.stamp_check import StampCheck, Verdict
from fss_gnc.navigation.tracked_body import TrackedBody
from fss_gnc.navigation.valve_faults import Faults
from fss_gnc.programs import navigation as main


class NavigationNode(Node):
    """Publish base/state and target/state, through outages too, until the state is unknown.

    The node merges poses of motion capture with the gyro. It predicts with the pulses of the
    thrusters and with the motion of the joints. Diagnostics report why a state is unknown.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("navigation", **options)
        s = self.settings = declare(self, NavigationSettings)
        self.clock = timer_clock(self)
        self.known = Calibrated(load_described_arm(self, s.arm))
        self.stamps = StampCheck(s.base_topic, lambda: int(self.clock.now().nanoseconds))
        self.rejected: Counter[str] = Counter()
        self.timing = Timing(s.rate, self)
        self.pulses = 0  # number of accepted commands to the valves
        self.state = self.create_publisher(Odometry, "base/state", SENSOR)
        self.target = self.create_publisher(Odometry, "target/state", SENSOR)
        self.held = self.create_publisher(MassProperties, "target/mass_properties", SENSOR)
        self.valves = self.create_publisher(ThrusterHealth, "thrusters/health", LATCHED)
        self.transform = self.create_publisher(TFMessage, "/tf", SENSOR)
        self.reset()
        for topic in (s.base_topic, s.target_topic):
            subscribe_sensor(self, PoseStamped, topic, partial(self.on_pose, topic))
        subscribe_sensor(self, Imu, "fog/imu", self.on_gyro)
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)
        subscribe_sensor(self, JointTrajectory, "arm/planned", self.on_planned)
        subscribe_sensor(self, ThrusterCommand, "thrusters/pulses", self.on_pulses)
        subscribe_sensor(
            self, GripperState, "gripper/state", lambda m: self.navigation.set_gripper(m.holds)
        )
        subscribe_calibrations(self, self.on_calibration)
        self.create_timer(1.0 / s.rate, self.publish_states, clock=self.clock)
        self.diagnostics = Diagnostics(self, self.health, timing=self.timing)
        topics = f"{s.base_topic}, {s.target_topic}, fog/imu, joint_states"
        self.get_logger().info(f"subscribed to {topics} (joints: {self.known.arm.n})")

    def reset(self, faults: Faults | None = None) -> None:
        """Reset the estimates of base and target; known faults of the valves stay."""
        s = self.settings
        n = self.navigation = Navigation(self.known.arm, s, s.target_errors(), s.assumed_body(), s)
        self.base = TrackedBody(n.base, n.base.update_pose, self.publish_base)
        self.target_body = TrackedBody(n.target, n.update_target_pose, self.publish_target)
        n.valves.faults = faults._replace(unknown_push=False) if faults else n.valves.faults
        self.publish_faults(n.valves.faults)

    def accept_stamp(self, topic: str, t: int) -> bool:
        """Return True if a stamp [ns] is plausible; reset if the base's stamps jump."""
        verdict = self.stamps.check(topic, t)
        if verdict in (Verdict.FROM_FUTURE, Verdict.JUMPED_FORWARD):
            self.rejected[f"{topic} from the future"] += 1
        if verdict in (Verdict.JUMPED_FORWARD, Verdict.JUMPED_BACK):
            self.get_logger().warning(f"{topic} {verdict.value} to {t / 1e9:.1f} s: filters reset")
            self.reset(self.navigation.valves.faults)
        return verdict is not Verdict.FROM_FUTURE

    def on_pose(self, topic: str, message: PoseStamped) -> None:
        """Process a pose of base or target."""
        t = stamp_ns(message.header.stamp) - round(self.settings.latency * SECOND)
        if (pose := seen_pose(message)) is None:
            self.rejected[f"{topic} occluded"] += 1
        elif self.accept_stamp(topic, t):
            body = self.base if topic == self.settings.base_topic else self.target_body
            body.update_pose(t, pose)
            self.timing.add_command(t)

    def on_gyro(self, message: Imu) -> None:
        """Update the base's filter with a sample of its rate."""
        t = stamp_ns(message.header.stamp)
        if self.accept_stamp("fog/imu", t):
            self.navigation.base.update_rate(t, message.angular_velocity.z)

    def on_joints(self, message: JointState) -> None:
        """Process readings of one link or more."""
        if self.accept_stamp("joint_states", t := stamp_ns(message.header.stamp)):
            self.navigation.add_joint_readings(t, joint_readings(message))

    def on_planned(self, message: JointTrajectory) -> None:
        """Store the planned rates of the joints."""
        try:
            self.navigation.inputs.set_plan(*planned_rates(message, self.known.arm))
        except ValueError:
            self.rejected["arm/planned rejected"] += 1

    def on_pulses(self, message: ThrusterCommand) -> None:
        """Process a command to the valves."""
        t = stamp_ns(message.header.stamp)
        accepted = self.accept_stamp("thrusters/pulses", t)
        if accepted and self.navigation.add_pulses(t, message.on_time):
            self.pulses += 1
        elif accepted:
            self.rejected["thrusters/pulses rejected"] += 1

    def on_calibration(self, topic: str, message: Any) -> None:
        """Use an accepted calibration of the arm."""
        try:
            known = self.known.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"{topic} rejected: {error}")
            return
        if known is not self.known:
            self.known = known
            self.navigation.set_arm(known.arm)
            self.get_logger().info(f"using {topic} of {known.arm.name}")

    def publish_base(self, state: BodyState) -> None:
        """Publish the base's state and transform."""
        frames = self.settings.world_frame, self.settings.base_frame
        self.state.publish(messages.odometry(state, *frames))
        self.transform.publish(messages.transform(state, *frames))

    def publish_target(self, state: BodyState) -> None:
        """Publish the target's state."""
        frames = self.settings.world_frame, self.settings.target_frame
        self.target.publish(messages.odometry(state, *frames))

    def publish_states(self) -> None:
        """Predict bodies without new poses, and publish their states while they are known."""
        now = self.stamps.now()
        self.timing.add_step()
        for body in (self.base, self.target_body):
            body.publish_if_due(now, 0.5 * SECOND / self.settings.rate, self.navigation.predict)
        n, frame_id = self.navigation, f"{self.settings.frame_prefix}link_{self.known.arm.n}"
        if (found := n.estimate_mass(now)) is not None and (solver := n.mass_estimator) is not None:
            self.held.publish(messages.mass_properties(found, len(solver.samples), now, frame_id))
        if faults := n.detect_valve_faults(now):
            self.publish_faults(faults)

    def publish_faults(self, faults: Faults) -> None:
        """Publish which valves do not follow their commands."""
        now, frame_id = self.get_clock().now().nanoseconds, self.settings.base_frame
        self.valves.publish(messages.thruster_health(faults, now, frame_id))
        for problem in valve_problems(faults):
            self.get_logger().warning(problem)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        bodies = self.navigation, self.base, self.target_body
        problems = "; ".join(find_problems(*bodies, self.stamps.now(), self.stamps.topics_ahead()))
        values = diagnostic_values(*bodies, self.pulses, self.rejected)
        return Health(WARN if problems else OK, problems or "tracking", values)


if __name__ == "__main__":
    sys.exit(main())
