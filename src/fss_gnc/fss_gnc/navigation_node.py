"""Node `navigation`: estimates pose and twist of base and target for all other nodes."""

import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory

from fss_arm_model.description_file import described
from fss_arm_model.thrusters import COUNT
from fss_arm_msgs.msg import (
    DynamicCalibration,
    GripperState,
    KinematicCalibration,
    MassProperties,
    ThrusterCommand,
    ThrusterHealth,
)
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import (
    SECOND,
    PoseError,
    joint_readings,
    planar_pose,
    stamp_ns,
    to_time,
)
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor
from fss_arm_ros.stamps import MIN_SAMPLES, Stamps
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe
from fss_gnc import messages
from fss_gnc.navigation import Navigation
from fss_gnc.navigation.body_filter import POSE, RATE, BodyFilter, BodyState
from fss_gnc.navigation.messages import odometry, transform
from fss_gnc.navigation.settings import NavigationSettings
from fss_gnc.navigation.valve_faults import Faults
from fss_gnc.programs import navigation as main

MAX_LEAD = SECOND  # of a stamp; larger ones are accepted after MIN_SAMPLES in a row [ns]
GYRO_TIMEOUT = SECOND // 2  # [ns]


class Body:
    """Filter of a body, and the publisher of its state."""

    def __init__(self, filter_: BodyFilter, publish: Callable[[Any], None]) -> None:
        self.filter, self.publish = filter_, publish
        self.published = -1  # time of the newest published state [ns]
        self.lost = "not seen yet"  # why nothing is published; empty: the state is published

    def tell(self, t: int) -> None:
        """Publish the state, if it is known at t [ns] and newer than the last one."""
        self.lost = self.filter.lost(t)
        if not self.lost and self.filter.t > self.published:
            self.published = self.filter.t
            self.publish(self.filter.state())


class NavigationNode(Node):
    """Publish base/state and target/state, through outages too, until the state is unknown.

    The node merges poses of motion capture with the gyro. It predicts with the pulses of the
    thrusters
    and with the motion of the joints. When the state of a body becomes unknown, the node stops
    publishing it and reports the reason in diagnostics.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("navigation", **options)
        s = self.settings = declare(self, NavigationSettings)
        self.clock = timer_clock(self)
        self.known = Calibrated(described(s.arm))
        self.latency = round(s.latency * SECOND)
        self.refused: Counter[str] = Counter()
        self.pulses = 0  # number of accepted commands to the valves
        self.state = self.create_publisher(Odometry, "base/state", SENSOR)
        self.target = self.create_publisher(Odometry, "target/state", SENSOR)
        self.held = self.create_publisher(MassProperties, "target/mass_properties", SENSOR)
        self.valves = self.create_publisher(ThrusterHealth, "thrusters/health", LATCHED)
        self.transform = self.create_publisher(TFMessage, "/tf", SENSOR)
        self.begin()
        for kind, topic, callback in (
            (PoseStamped, s.base_topic, self.on_base),
            (PoseStamped, s.target_topic, self.on_target),
            (Imu, s.gyro_topic, self.on_gyro),
        ):
            subscribe_sensor(self, kind, topic, callback)
        subscribe_sensor(self, JointState, s.joints_topic, self.on_joints)
        subscribe_sensor(self, JointTrajectory, "arm/planned", self.on_planned)
        subscribe_sensor(self, ThrusterCommand, "thrusters/pulses", self.on_pulses)
        subscribe_sensor(self, GripperState, "gripper/state", self.on_gripper)
        for kind, topic in (
            (KinematicCalibration, "calibration/kinematic"),
            (DynamicCalibration, "calibration/dynamic"),
        ):
            subscribe(self, kind, topic, partial(self.on_calibration, topic), LATCHED)
        self.create_timer(1.0 / s.rate, self.go_on, clock=self.clock)
        self.diagnostics = Diagnostics(self, self.health)

    def begin(self) -> None:
        """Reset the estimates of base and target."""
        s = self.settings
        self.navigation = Navigation(self.known.arm, s, s.of_target(), s.body(), s)
        self.base = Body(self.navigation.base, self.publish_base)
        self.free = Body(self.navigation.target, self.publish_target)
        self.stamps: dict[str, Stamps] = defaultdict(Stamps)  # by topic
        self.ahead: Counter[str] = Counter()  # consecutive stamps from the future, by topic
        self.tell(self.navigation.valves.found)
        self.newest = self.heard = -1  # stamp of the base's newest pose, and its arrival [ns]

    def now(self) -> int:
        """Return the present in the time of the base's stamps [ns].

        Before the base's first pose, the first stamp of any topic is used instead.
        """
        return self.newest + max(self.clock.now().nanoseconds - self.heard, 0)

    def is_timely(self, topic: str, t: int) -> bool:
        """Return True if a stamp [ns] is plausible; reset if the base's stamps jump."""
        if self.newest >= 0 and t > self.now() + MAX_LEAD:
            self.refused[f"{topic} from the future"] += 1
            self.ahead[topic] += 1
            if self.ahead[topic] < MIN_SAMPLES or topic != self.settings.base_topic:
                return False
            self.get_logger().warning(f"{topic} went on to {t / SECOND:.1f} s: begins anew")
            self.begin()
        self.ahead[topic] = 0
        if self.stamps[topic].set_back(t) and topic == self.settings.base_topic:
            self.get_logger().warning(f"{topic} went back to {t / SECOND:.1f} s: begins anew")
            self.begin()
        if self.newest < 0 or t == self.stamps[self.settings.base_topic].newest:
            self.newest, self.heard = t, self.clock.now().nanoseconds
        return True

    def on_base(self, message: PoseStamped) -> None:
        """Process a pose of the base."""
        self.on_pose(self.settings.base_topic, message)

    def on_target(self, message: PoseStamped) -> None:
        """Process a pose of the target."""
        self.on_pose(self.settings.target_topic, message)

    def on_pose(self, topic: str, message: PoseStamped) -> None:
        """Process a pose of base or target."""
        is_base = topic == self.settings.base_topic
        try:
            pose = planar_pose(message.pose)
        except PoseError:
            self.refused[f"{topic} occluded"] += 1
            return
        t = stamp_ns(message.header.stamp) - self.latency
        if self.is_timely(topic, t):
            take = self.navigation.base.pose if is_base else self.navigation.target_pose
            if take(t, *pose):
                (self.base if is_base else self.free).tell(t)

    def on_gyro(self, message: Imu) -> None:
        """Update the base's filter with a sample of its rate."""
        t = stamp_ns(message.header.stamp)
        if self.is_timely(self.settings.gyro_topic, t):
            self.navigation.base.rate(t, message.angular_velocity.z)

    def on_joints(self, message: JointState) -> None:
        """Process readings of one link or more."""
        t = stamp_ns(message.header.stamp)
        if self.is_timely(self.settings.joints_topic, t):
            for i, q, qd, _ in joint_readings(message):
                if 1 <= i <= self.known.arm.n:
                    self.navigation.joint(i - 1, t, q, qd)

    def on_planned(self, message: JointTrajectory) -> None:
        """Store the planned rates of the joints."""
        try:
            plan = messages.planned_rates(message, self.known.arm)
        except ValueError:
            self.refused["arm/planned refused"] += 1
        else:
            self.navigation.inputs.plan(*plan)

    def on_pulses(self, message: ThrusterCommand) -> None:
        """Process a command to the valves."""
        t = stamp_ns(message.header.stamp)
        timely = self.is_timely("thrusters/pulses", t)
        if timely and self.navigation.pulses(t, message.on_time):
            self.pulses += 1
        elif timely:
            self.refused["thrusters/pulses refused"] += 1

    def on_gripper(self, message: GripperState) -> None:
        """Process the gripper's report that it holds the target, or does not."""
        self.navigation.gripper(message.holds)

    def on_calibration(self, topic: str, message: Any) -> None:
        """Use an accepted calibration of the arm."""
        try:
            known = self.known.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"{topic} is left out: {error}")
            return
        if known is not self.known:
            self.known = known
            self.navigation.describe(known.arm)
            self.get_logger().info(f"predicts with {topic} of {known.arm.name}")

    def publish_base(self, state: BodyState) -> None:
        """Publish the base's state and transform."""
        frames = self.settings.world_frame, self.settings.base_frame
        self.state.publish(odometry(state, *frames))
        self.transform.publish(transform(state, *frames))

    def publish_target(self, state: BodyState) -> None:
        """Publish the target's state."""
        self.target.publish(odometry(state, self.settings.world_frame, self.settings.target_frame))

    def go_on(self) -> None:
        """Predict bodies that are not seen, and publish their states while they are known."""
        now = self.now()
        for body in (self.base, self.free):
            body.lost = body.filter.lost(now)
            if now - body.published > 0.5 * SECOND / self.settings.rate:
                if not body.lost:
                    self.navigation.predict(now)
                body.tell(now)
        self.learn(now)
        if faults := self.navigation.diagnose(now):
            self.tell(faults)

    def learn(self, now: int) -> None:
        """Publish the mass properties of the held body, if there is a new estimate."""
        n = self.navigation
        found = n.observe(now)
        if found is None or n.caught is None:
            return
        message = MassProperties(
            mass=float(found.values[0]), com=found.values[1:3], inertia=float(found.values[3]),
            covariance=found.covariance.ravel(), samples=len(n.caught.samples),
        )  # fmt: skip
        message.header.stamp = to_time(now)
        message.header.frame_id = f"{self.settings.frame_prefix}link_{self.known.arm.n}"
        self.held.publish(message)

    def tell(self, faults: Faults) -> None:
        """Publish which valves do not follow their commands."""
        message = ThrusterHealth(
            stuck_open=[i in faults.open for i in range(COUNT)],
            stuck_closed=[i in faults.closed for i in range(COUNT)], pushed=faults.pushed,
        )  # fmt: skip
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self.settings.base_frame
        self.valves.publish(message)
        for words in valve_words(faults):
            self.get_logger().warning(words)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        now, n = self.now(), self.navigation
        values: dict[str, Any] = {
            "base": self.base.lost or "known",
            "target": self.free.lost or ("held" if n.holds else "known"),
            "NIS of poses, 3 if as expected": mean(n.base.nis[POSE]),
            "NIS of rates, 1 if as expected": mean(n.base.nis[RATE]),
            "pulses heard": self.pulses,
            "begun anew": max(n.base.begun - 1, 0),
            **self.refused,
            **{f"base: {what} rejected": count for what, count in n.base.rejected.items()},
            **{f"target: {what} rejected": count for what, count in n.target.rejected.items()},
        }
        if n.base.events:
            values["bias of the gyro [rad/s]"] = n.base.bias
        return Health(WARN if (words := self.troubles(now)) else OK, words or "knows", values)

    def troubles(self, now: int) -> str:
        """Return all present problems as one line; empty if there are none."""
        n, words = self.navigation, []
        if self.base.lost:
            words.append(f"base {self.base.lost}")
        elif now - n.base.seen > GYRO_TIMEOUT:
            words.append(f"base predicted, not seen for {(now - n.base.seen) / SECOND:.1f} s")
        if self.free.lost and n.target.events:
            words.append(f"target {self.free.lost}")
        if n.base.events and now - n.base.turned > GYRO_TIMEOUT:
            words.append("no gyro: by motion capture alone")
        if not n.inputs.heard_at(now):
            words.append("not every joint is heard: the arm's motion is not known")
        if n.caught and not n.caught.explained:
            words.append("something pushes that no mass of what is held explains")
        words += valve_words(n.valves.found)
        words += [f"{name} is seen where {of}" for name, of in n.confused(now)]
        return "; ".join(words)


def valve_words(faults: Faults) -> list[str]:
    """Return the faults of the valves as sentences."""
    words = [f"valve {i + 1} does not close" for i in sorted(faults.open)]
    words += [f"valve {i + 1} does not open" for i in sorted(faults.closed)]
    return words + ["something pushes that is not known"] * faults.pushed


def mean(values: Any) -> float:
    """Return the mean; NaN if there are no values."""
    return sum(values) / len(values) if values else float("nan")


if __name__ == "__main__":
    sys.exit(main())
