"""State topics of the arm's node: all joints in one message, transforms, the description."""

from dataclasses import replace
from functools import partial
from math import cos, sin
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fss_arm_driver.arm.link_topics import LinkTopics
from fss_arm_driver.arm.state import Joints, extrapolate
from fss_arm_model.description import joint_names
from fss_arm_model.urdf import Frame, frames, urdf
from fss_arm_msgs.msg import DynamicCalibration, KinematicCalibration
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import to_time
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor
from fss_arm_ros.validation import subscribe

CALIBRATIONS = (
    ("calibration/kinematic", KinematicCalibration),
    ("calibration/dynamic", DynamicCalibration),
)

PLAN_STEP, PLAN_POINTS = 100_000_000, 6  # interval [ns] and number of the points of arm/planned


PROPELLANT_STEP = 0.005  # of propellant; the description is updated for each one used [kg]


class StateTopics:
    """Publisher of `arm/joint_states`, `arm/planned`, /tf, /tf_static and `robot_description`."""

    def __init__(self, links: LinkTopics) -> None:
        self.links, node, s = links, links.node, links.settings
        self.calibrated = Calibrated(links.arm)
        self.used = 0.0  # propellant that the base has used [kg]
        self.withheld_reason = ""  # why there are no joint states, in words
        self.joint_states = node.create_publisher(JointState, "arm/joint_states", SENSOR)
        self.planned = node.create_publisher(JointTrajectory, "arm/planned", SENSOR)
        self.description = node.create_publisher(String, "robot_description", LATCHED)
        self.tf = self.tf_static = None
        if s.publish_tf:
            self.tf = node.create_publisher(TFMessage, "/tf", 100)
            self.tf_static = node.create_publisher(TFMessage, "/tf_static", LATCHED)
        for topic, kind in CALIBRATIONS:
            subscribe(node, kind, topic, partial(self.on_calibration, topic), LATCHED)
        subscribe_sensor(node, Float64, "base/propellant", self.on_propellant)
        node.create_timer(1.0 / s.state_rate, self.publish, clock=links.clock)
        self.publish_description()

    def on_calibration(self, topic: str, message: Any) -> None:
        """Update the description from a valid calibration."""
        try:
            found = self.calibrated.of_same_links(topic, message)
        except ValueError as error:
            self.links.node.get_logger().warning(f"{topic} rejected: {error}")
            return
        if found.arm != self.calibrated.arm:
            self.calibrated = found
            self.publish_description()

    def on_propellant(self, message: Float64) -> None:
        """Update the base's mass in the description from the remaining propellant."""
        used = self.links.settings.full_tank - message.data
        if abs(used - self.used) >= PROPELLANT_STEP and used < self.calibrated.arm.base.mass:
            self.used = used
            self.publish_description()

    def publish_description(self) -> None:
        """Publish the description and its fixed transforms."""
        base = self.calibrated.arm.base
        arm = replace(self.calibrated.arm, base=replace(base, mass=base.mass - self.used))
        self.description.publish(String(data=urdf(arm)))
        self.frames = frames(arm)
        if self.tf_static:
            now, fixed = self.links.now(), [f for f in self.frames if not f.joint]
            self.tf_static.publish(
                TFMessage(transforms=[self.transform(f, 0.0, now) for f in fixed])
            )

    def publish(self) -> None:
        """Publish all joints at the present time, and the links' transforms."""
        links, now = self.links, self.links.now()
        joints = extrapolate(links.states, links.arm.n, now, links.settings.max_extrapolation)
        if isinstance(joints, str):
            self.withheld_reason = joints
            return
        self.withheld_reason = ""
        message = JointState(
            name=joint_names(links.arm.n),
            position=joints.q,
            velocity=joints.qd,
            effort=joints.effort,
        )
        message.header.stamp = to_time(now)
        self.joint_states.publish(message)
        self.planned.publish(self.planned_motion(joints, now))
        if self.tf:
            moving = [self.transform(f, joints.q[f.joint - 1], now) for f in self.frames if f.joint]
            self.tf.publish(TFMessage(transforms=moving))

    def transform(self, frame: Frame, q: float, at: int) -> TransformStamped:
        """Return a link's pose in its parent's frame, with its joint at q [rad]."""
        prefix = self.links.settings.frame_prefix
        message = TransformStamped(child_frame_id=prefix + frame.name)
        message.header.stamp, message.header.frame_id = to_time(at), prefix + frame.parent
        message.transform.translation.x, message.transform.translation.y = frame.x, frame.y
        half = 0.5 * (frame.theta + q)
        message.transform.rotation.z, message.transform.rotation.w = sin(half), cos(half)
        return message

    def planned_motion(self, joints: Joints, now: int) -> JointTrajectory:
        """Return the joints' planned motion from now on; without a plan, the present state."""
        message = JointTrajectory(joint_names=joint_names(self.links.arm.n))
        message.header.stamp = to_time(now)
        plan = self.links.arbiter.current_plan(now)
        for k in range(PLAN_POINTS if plan else 1):
            q, qd = plan(now + k * PLAN_STEP) if plan else (joints.q, joints.qd)
            since = Duration(nanoseconds=k * PLAN_STEP).to_msg()
            message.points.append(
                JointTrajectoryPoint(positions=list(q), velocities=list(qd), time_from_start=since)
            )
        return message
