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


class TrackedBody:
    """Filter of a body, and the publisher of its state."""

    def __init__(self, filter_: BodyFilter, publish: Callable[[Any], None]) -> None:
        self.filter, self.publish = filter_, publish
        self.published = -1  # time of the newest published state [ns]
        self.lost_reason = (
            "not observed yet"  # why nothing is published; empty: the state is published
        )

    def publish_if_new(self, t: int) -> None:
        """Publish the state, if it is known at t [ns] and newer than the last one."""
        self.lost_reason = self.filter.lost_reason(t)
        if not self.lost_reason and self.filter.t > self.published:
            self.published = self.filter.t
            self.publish(self.filter.state())


class NavigationNode(Node):
    """Publish base/state and target/state, through outages too, until the state is unknown.

    The node merges poses of motion capture with the gyro. It predicts with the pulses of the
    thrusters and with the motion of the joints. When the state of a body becomes unknown, the
    node stops publishing it and reports the reason in diagnostics.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("navigation", **options)
        s = self.settings = declare(self, NavigationSettings)
        self.clock = timer_clock(self)
        self.known = Calibrated(described(s.arm))
        self.latency = round(s.latency * SECOND)
        self.rejected: Counter[str] = Counter()
        self.pulses = 0  # number of accepted commands to the valves
        self.state = self.create_publisher(Odometry, "base/state", SENSOR)
        self.target = self.create_publisher(Odometry, "target/state", SENSOR)
        self.held = self.create_publisher(MassProperties, "target/mass_properties", SENSOR)
        self.valves = self.create_publisher(ThrusterHealth, "thrusters/health", LATCHED)
        self.transform = self.create_publisher(TFMessage, "/tf", SENSOR)
        self.reset()
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
        self.create_timer(1.0 / s.rate, self.publish_states, clock=self.clock)
        self.diagnostics = Diagnostics(self, self.health)

    def reset(self) -> None:
        """Reset the estimates of base and target."""
        s = self.settings
        self.navigation = Navigation(self.known.arm, s, s.target_errors(), s.assumed_body(), s)
        self.base = TrackedBody(self.navigation.base, self.publish_base)
        self.target_body = TrackedBody(self.navigation.target, self.publish_target)
        self.stamps: dict[str, Stamps] = defaultdict(Stamps)  # by topic
        self.future_count: Counter[str] = Counter()  # consecutive stamps from the future, by topic
        self.publish_faults(self.navigation.valves.faults)
        self.newest_stamp = self.newest_arrival = -1  # of the base's newest pose [ns]

    def now(self) -> int:
        """Return the present in the time of the base's stamps [ns].

        Before the base's first pose, the first stamp of any topic is used instead.
        """
        return self.newest_stamp + max(self.clock.now().nanoseconds - self.newest_arrival, 0)

    def accept_stamp(self, topic: str, t: int) -> bool:
        """Return True if a stamp [ns] is plausible; reset if the base's stamps jump."""
        if self.newest_stamp >= 0 and t > self.now() + MAX_LEAD:
            self.rejected[f"{topic} from the future"] += 1
            self.future_count[topic] += 1
            if self.future_count[topic] < MIN_SAMPLES or topic != self.settings.base_topic:
                return False
            self.get_logger().warning(
                f"{topic} jumped forward to {t / SECOND:.1f} s: filters reset"
            )
            self.reset()
        self.future_count[topic] = 0
        if self.stamps[topic].set_back(t) and topic == self.settings.base_topic:
            self.get_logger().warning(f"{topic} jumped back to {t / SECOND:.1f} s: filters reset")
            self.reset()
        if self.newest_stamp < 0 or t == self.stamps[self.settings.base_topic].newest:
            self.newest_stamp, self.newest_arrival = t, self.clock.now().nanoseconds
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
            self.rejected[f"{topic} occluded"] += 1
            return
        t = stamp_ns(message.header.stamp) - self.latency
        if self.accept_stamp(topic, t):
            update = (
                self.navigation.base.update_pose if is_base else self.navigation.update_target_pose
            )
            if update(t, *pose):
                (self.base if is_base else self.target_body).publish_if_new(t)

    def on_gyro(self, message: Imu) -> None:
        """Update the base's filter with a sample of its rate."""
        t = stamp_ns(message.header.stamp)
        if self.accept_stamp(self.settings.gyro_topic, t):
            self.navigation.base.update_rate(t, message.angular_velocity.z)

    def on_joints(self, message: JointState) -> None:
        """Process readings of one link or more."""
        t = stamp_ns(message.header.stamp)
        if self.accept_stamp(self.settings.joints_topic, t):
            for i, q, qd, _ in joint_readings(message):
                if 1 <= i <= self.known.arm.n:
                    self.navigation.add_joint_reading(i - 1, t, q, qd)

    def on_planned(self, message: JointTrajectory) -> None:
        """Store the planned rates of the joints."""
        try:
            plan = messages.planned_rates(message, self.known.arm)
        except ValueError:
            self.rejected["arm/planned rejected"] += 1
        else:
            self.navigation.inputs.set_plan(*plan)

    def on_pulses(self, message: ThrusterCommand) -> None:
        """Process a command to the valves."""
        t = stamp_ns(message.header.stamp)
        accepted = self.accept_stamp("thrusters/pulses", t)
        if accepted and self.navigation.add_pulses(t, message.on_time):
            self.pulses += 1
        elif accepted:
            self.rejected["thrusters/pulses rejected"] += 1

    def on_gripper(self, message: GripperState) -> None:
        """Process the gripper's report that it holds the target, or does not."""
        self.navigation.set_gripper(message.holds)

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
        self.state.publish(odometry(state, *frames))
        self.transform.publish(transform(state, *frames))

    def publish_target(self, state: BodyState) -> None:
        """Publish the target's state."""
        self.target.publish(odometry(state, self.settings.world_frame, self.settings.target_frame))

    def publish_states(self) -> None:
        """Predict bodies without new poses, and publish their states while they are known."""
        now = self.now()
        for body in (self.base, self.target_body):
            body.lost_reason = body.filter.lost_reason(now)
            if now - body.published > 0.5 * SECOND / self.settings.rate:
                if not body.lost_reason:
                    self.navigation.predict(now)
                body.publish_if_new(now)
        self.publish_mass_properties(now)
        if faults := self.navigation.detect_valve_faults(now):
            self.publish_faults(faults)

    def publish_mass_properties(self, now: int) -> None:
        """Publish the mass properties of the held body, if there is a new estimate."""
        n = self.navigation
        found = n.estimate_mass(now)
        if found is None or n.mass_estimator is None:
            return
        message = MassProperties(
            mass=float(found.values[0]), com=found.values[1:3], inertia=float(found.values[3]),
            covariance=found.covariance.ravel(), samples=len(n.mass_estimator.samples),
        )  # fmt: skip
        message.header.stamp = to_time(now)
        message.header.frame_id = f"{self.settings.frame_prefix}link_{self.known.arm.n}"
        self.held.publish(message)

    def publish_faults(self, faults: Faults) -> None:
        """Publish which valves do not follow their commands."""
        message = ThrusterHealth(
            stuck_open=[i in faults.open for i in range(COUNT)],
            stuck_closed=[i in faults.closed for i in range(COUNT)], pushed=faults.unknown_push,
        )  # fmt: skip
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self.settings.base_frame
        self.valves.publish(message)
        for problem in valve_problems(faults):
            self.get_logger().warning(problem)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        now, n = self.now(), self.navigation
        values: dict[str, Any] = {
            "base": self.base.lost_reason or "known",
            "target": self.target_body.lost_reason or ("held" if n.holds else "known"),
            "NIS of poses (expected: 3)": mean(n.base.nis[POSE]),
            "NIS of rates (expected: 1)": mean(n.base.nis[RATE]),
            "pulses received": self.pulses,
            "filter restarts": max(n.base.start_count - 1, 0),
            **self.rejected,
            **{f"base: {kind} rejected": count for kind, count in n.base.rejected.items()},
            **{f"target: {kind} rejected": count for kind, count in n.target.rejected.items()},
        }
        if n.base.events:
            values["gyro bias [rad/s]"] = n.base.bias
        return Health(
            WARN if (problems := self.problems(now)) else OK, problems or "tracking", values
        )

    def problems(self, now: int) -> str:
        """Return all present problems as one line; empty if there are none."""
        n, problems = self.navigation, []
        if self.base.lost_reason:
            problems.append(f"base {self.base.lost_reason}")
        elif now - n.base.last_pose_time > GYRO_TIMEOUT:
            problems.append(
                f"base predicted, not observed for {(now - n.base.last_pose_time) / SECOND:.1f} s"
            )
        if self.target_body.lost_reason and n.target.events:
            problems.append(f"target {self.target_body.lost_reason}")
        if n.base.events and now - n.base.last_rate_time > GYRO_TIMEOUT:
            problems.append("no gyro: heading from motion capture only")
        if not n.inputs.joints_are_recent(now):
            problems.append("readings of a joint are missing: motion of the arm unknown")
        if n.mass_estimator and not n.mass_estimator.is_consistent:
            problems.append("an unknown force pushes: no mass of the held body explains the motion")
        problems += valve_problems(n.valves.faults)
        problems += [f"pose of the {name} fits the {other}" for name, other in n.recent_mixups(now)]
        return "; ".join(problems)


def valve_problems(faults: Faults) -> list[str]:
    """Return the faults of the valves as sentences."""
    problems = [f"valve {i + 1} does not close" for i in sorted(faults.open)]
    problems += [f"valve {i + 1} does not open" for i in sorted(faults.closed)]
    return problems + ["an unknown force pushes the base"] * faults.unknown_push


def mean(values: Any) -> float:
    """Return the mean; NaN if there are no values."""
    return sum(values) / len(values) if values else float("nan")


if __name__ == "__main__":
    sys.exit(main())
