"""Node `base_reaction`: publishes the base's motion, predicted and measured."""

import sys
from collections import defaultdict
from functools import partial
from math import isfinite
from time import monotonic
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from tf2_msgs.msg import TFMessage

from fss_arm_model.description import joint_names
from fss_arm_msgs.msg import BaseReaction as BaseReactionMessage
from fss_arm_msgs.msg import DynamicCalibration, KinematicCalibration, ThrusterCommand
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import SECOND, joint_readings, seen_pose, stamp_ns
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, SENSOR, sensor, subscribe_sensor
from fss_arm_ros.stamps import Stamps
from fss_arm_ros.validation import subscribe
from fss_gnc.navigation import BodyFilter
from fss_gnc.navigation.messages import odometry, transform

from .base_reaction import BaseReaction
from .base_reaction.inputs import TIMEOUT, InputMonitor
from .messages import reaction_message
from .programs import base_reaction as main
from .settings import BaseReactionSettings

#: Topics of calibrations. The time_offset of a kinematic result is that of the joints, that of a
#: dynamic result is that of joints and gyro.
KINEMATIC, DYNAMIC = "calibration/kinematic", "calibration/dynamic"


class BaseReactionNode(Node):
    """Node that publishes base/state and base_reaction, how the arm moves the base."""

    def __init__(self, **options: Any) -> None:
        super().__init__("base_reaction", **options)
        s = self.settings = declare(self, BaseReactionSettings)
        self.calibrated = Calibrated(load_described_arm(self, s.arm))
        self.offsets: dict[str, int] = {}  # clock offsets to motion capture [ns], by calibration
        self.reset()
        self.occluded = 0
        self.inputs = InputMonitor()
        self.last_published = monotonic()  # time of the last published reaction [s]
        self.state_publisher = self.transform_publisher = None
        if s.publish_state:
            self.state_publisher = self.create_publisher(Odometry, "base/state", SENSOR)
            self.transform_publisher = self.create_publisher(TFMessage, "/tf", SENSOR)
        self.reaction_publisher = self.create_publisher(
            BaseReactionMessage, "base_reaction", SENSOR
        )
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)
        subscribe_sensor(self, PoseStamped, s.base_topic, self.on_pose)
        subscribe_sensor(self, Imu, "fog/imu", self.on_gyro)
        best_effort = sensor(best_effort=True)
        subscribe(self, ThrusterCommand, "thrusters/pulses", self.on_thrust, best_effort)
        for kind, topic in (
            (KinematicCalibration, KINEMATIC),
            (DynamicCalibration, DYNAMIC),
        ):
            subscribe(self, kind, topic, partial(self.on_calibration, topic), LATCHED)
        self.diagnostics = Diagnostics(self, self.health)
        self.get_logger().info(f"subscribed to {s.base_topic} (joints: {self.calibrated.arm.n})")

    def reset(self) -> None:
        """Reset filter and prediction; keep the calibrated arm."""
        self.stamps: dict[str, Stamps] = defaultdict(Stamps)  # by topic
        self.filter = BodyFilter(self.settings)
        self.reaction = BaseReaction(self.calibrated.arm, self.calibrated.covariance, self.settings)
        self.pose: tuple[float, float, float] | None = None  # last pose received

    def check_stamp(self, topic: str, message: Any) -> int:
        """Return a message's stamp [ns]; if a topic's stamps jump back, reset the node."""
        t = stamp_ns(message.header.stamp)
        if self.stamps[topic].set_back(t):
            self.get_logger().warning(
                f"stamps of {topic} jumped back to {t / SECOND:.1f} s: filter and prediction reset"
            )
            self.reset()
        return t

    def on_joints(self, message: JointState) -> None:
        """Add readings of one or more links; publish the reaction at all times known now."""
        t = self.check_stamp("joint_states", message)
        t -= self.offsets.get(KINEMATIC, self.offsets.get(DYNAMIC, 0))
        for i, q, qd, effort in joint_readings(message):
            if 1 <= i <= self.calibrated.arm.n and isfinite(q) and isfinite(qd):
                self.reaction.add_reading(i - 1, t, q, qd, effort)
                self.inputs.add(f"joint_{i}", monotonic())
        self.publish_reactions()

    def on_pose(self, message: PoseStamped) -> None:
        """Add a pose of the base; count occluded and repeated ones."""
        if (pose := seen_pose(message)) is None:
            self.occluded += 1
            return
        self.inputs.add(self.settings.base_topic, monotonic())
        t = self.check_stamp(self.settings.base_topic, message)
        if pose == self.pose and self.reaction.is_moving():
            self.filter.rejected["frozen"] += 1  # the motion capture receiver repeats its last pose
            return
        self.pose = pose
        if self.filter.update_pose(t, *pose):
            self.update_base()

    def on_gyro(self, message: Imu) -> None:
        """Add a sample of the base's rate."""
        t = self.check_stamp("fog/imu", message) - self.offsets.get(DYNAMIC, 0)
        self.filter.update_rate(t, message.angular_velocity.z)

    def on_thrust(self, message: ThrusterCommand) -> None:
        """Store when thrusters fire: a prediction from the joints does not include them."""
        self.reaction.add_thrust(stamp_ns(message.header.stamp), message.on_time)

    def on_calibration(self, topic: str, message: Any) -> None:
        """Use a calibration that passed for predictions, from the next rest on."""
        try:
            calibrated = self.calibrated.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"{topic} rejected: {error}")
            return
        if calibrated is not self.calibrated:
            self.calibrated = calibrated
            self.reaction.set_arm(calibrated.arm, calibrated.covariance)
            if isfinite(offset := message.calibration.time_offset):
                self.offsets[topic] = round(offset * SECOND)
            self.get_logger().info(f"predicting with {topic} of {calibrated.arm.name}")

    def update_base(self) -> None:
        """Store the filter's state of the base, and publish it."""
        state = self.filter.state()
        self.reaction.add_base_state(state)
        if self.state_publisher and self.transform_publisher:
            frames = self.settings.world_frame, self.settings.base_frame
            self.state_publisher.publish(odometry(state, *frames))
            self.transform_publisher.publish(transform(state, *frames))

    def publish_reactions(self) -> None:
        """Publish the reaction at `rate`, up to the last time that is known."""
        for reaction in self.reaction.due(int(SECOND / self.settings.rate)):
            self.last_published = monotonic()
            frame = self.settings.world_frame
            message = reaction_message(reaction, self.calibrated.arm.name, frame)
            self.reaction_publisher.publish(message)

    def health(self) -> Health:
        """Return the node's health for diagnostics."""
        values: dict[str, float] = {
            "poses occluded": self.occluded,
            **{f"{what} rejected": count for what, count in self.filter.rejected.items()},
        }
        count = self.filter.rejected["late"]
        late = f"; late samples of the base rejected: {count}" if count else ""
        if self.reaction.prediction is None:
            why = self.describe_missing_inputs() or "waiting for joints and base at rest"
            return Health(WARN, f"{why}{late}", values)
        silence = monotonic() - self.last_published
        values["silent for"] = silence
        if silence > TIMEOUT:
            why = self.describe_missing_inputs() or "stamps of joints and base have no common time"
            return Health(WARN, f"nothing published for {silence:.1f} s: {why}{late}", values)
        return Health(OK, f"predicting with {self.calibrated.arm.name}", values)

    def describe_missing_inputs(self) -> str:
        """Name the inputs that are silent; empty: none."""
        names = *joint_names(self.calibrated.arm.n), self.settings.base_topic
        return self.inputs.describe_missing(names, monotonic())


if __name__ == "__main__":
    sys.exit(main())
