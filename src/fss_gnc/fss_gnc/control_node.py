"""Node `control`: computes the wrench on the base from its state and its reference.

It publishes nothing, so that the valves close, while base, joints or trajectory are unknown, and
while it follows a trajectory without points.
"""

import sys
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from fss_arm_model import layout
from fss_arm_model.description_file import described
from fss_arm_model.held import Target, payload_pose, with_payload
from fss_arm_msgs.msg import GripperState, MassProperties
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import command, sensor
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import validators
from fss_gnc import bounds, messages
from fss_gnc.control.planned import PlannedRates
from fss_gnc.control.pose import PoseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.latest import Latest
from fss_gnc.programs import control as main
from fss_gnc.reference import Body, Floats, Path, Reference


class ControlNode(Node):
    """Publish base/wrench so that the base follows base/trajectory, whatever the arm does."""

    def __init__(self, **options: Any) -> None:
        super().__init__("control", **options)
        self.settings = s = declare(self, ControlSettings)
        self.arm = described(s.arm)
        self.assumed_target = Target(s.target_mass, s.target_inertia)
        self.control, self.planned = PoseControl(self.arm, s), PlannedRates()
        zero = np.zeros(3 + self.arm.n)  # loads the kernels, which takes long
        self.control.wrench(zero, zero, Reference.at_rest(zero[:3]), 1.0, zero[3:])
        self.base = Latest[Body]("base/state", s.max_age)
        self.target = Latest[Body]("target/state", s.max_age)
        self.joints = Latest[Floats]("arm/joint_states", s.max_age)
        self.trajectory = Latest[tuple[int, Path | None]]("base/trajectory", s.timeout)
        self.propellant_used, self.holds_target = 0.0, False
        self.place: Floats | None = None  # of the held target, in the last link's frame
        self.measured: tuple[Target, Floats] | None = None  # held body and its place, once measured
        self.problem, self.active = "", False
        self.polled: list[PolledSubscription] = []
        for topic in (self.base, self.target):
            self.subscribe_latest(Odometry, topic, messages.body)
        self.subscribe_latest(
            JointState, self.joints, lambda message: messages.joints(message, self.arm.n)
        )
        for kind, name, callback in (
            (MultiDOFJointTrajectory, "base/trajectory", self.on_trajectory),
            (JointTrajectory, "arm/planned", self.on_planned),
            (GripperState, "gripper/state", self.on_gripper),
            (MassProperties, "target/mass_properties", self.on_mass),
            (Float64, "base/propellant", self.on_propellant),
        ):
            qos = sensor(best_effort=True)  # a queue: every message counts
            self.polled.append(PolledSubscription(self, kind, name, callback, qos))
        self.wrench = self.create_publisher(WrenchStamped, "base/wrench", command(0.3))
        self.create_timer(1.0 / s.rate, self.tick, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health)

    def now(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def subscribe_latest(self, kind: type, topic: Latest[Any], read: Any) -> None:
        """Keep the newest valid message of a topic."""

        def store(message: Any) -> None:
            try:
                topic.store(stamp_ns(message.header.stamp), read(message))
            except ValueError as error:
                self.reject(topic.name, error)

        self.polled.append(PolledSubscription(self, kind, topic.name, store))

    def reject(self, topic: str, error: ValueError) -> None:
        """Count and log a rejected message, as the validation rule of its type does."""
        next(each for each in validators(self) if each.topic == topic).refuse(str(error))

    def on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        """Follow a new trajectory from now on; reject it if it is out of bounds."""
        now, stamp = self.now(), stamp_ns(message.header.stamp)
        try:
            path = messages.path(message)
            if path is not None:  # a message without points may always close the valves
                bounds.check_stamp(stamp, now, path.end_time, self.settings.timeout)
                bounds.check_reference(path, self.settings.table)
            self.trajectory.store(now, (stamp, path))
        except ValueError as error:
            self.reject("base/trajectory", error)

    def on_planned(self, message: JointTrajectory) -> None:
        """Store the rates planned for the joints."""
        try:
            self.planned.store(*messages.planned_rates(message, self.arm))
        except ValueError as error:
            self.reject("arm/planned", error)

    def on_propellant(self, message: Float64) -> None:
        """Compute the used propellant; a sensor with an offset may report a negative mass."""
        self.propellant_used = self.settings.full_tank - max(message.data, 0.0)

    def on_gripper(self, message: GripperState) -> None:
        """Store whether the target is part of the arm."""
        self.holds_target = message.holds
        if not message.holds:
            self.place = self.measured = None

    def on_mass(self, message: MassProperties) -> None:
        """Store the held body's mass properties as estimated by the navigation."""
        try:
            self.measured = messages.mass_properties(message) if self.holds_target else None
        except ValueError as error:
            self.reject("target/mass_properties", error)

    def tick(self) -> None:
        """Publish the wrench for the next period; without one, publish zero once, then nothing."""
        for subscription in self.polled:
            subscription.poll()
        wrench = self.compute_wrench()
        if wrench is not None:
            self.publish(wrench)
        elif self.active:
            self.publish(np.zeros(3))
            self.control.reset()
            self.planned.reset()
        self.active = wrench is not None

    def compute_wrench(self) -> Floats | None:
        """Return the wrench for the next period; None if the valves must stay closed."""
        now, period = self.now(), 1.0 / self.settings.rate
        self.problem = self.base.problem(now) or self.joints.problem(now)
        base, joints, trajectory = (
            self.base.valid_value(now),
            self.joints.value,
            self.trajectory.valid_value(now),
        )
        if base is None or joints is None or trajectory is None:
            return None
        stamp, path = trajectory
        if path is None:
            return None
        base, (q_m, qd_m, _) = base.extrapolate(self.base.age(now)), joints
        if self.joints.valid_value(now) is None:  # links stop without commands
            qd_m = np.zeros_like(qd_m)
        q = np.concatenate([base.pose, q_m + self.joints.age(now) * qd_m])
        self.control.p = self.model_parameters(q, now)
        qdd_m = self.planned.accelerations(now, period) if self.settings.feed_forward else None
        reference = path.at((now - stamp) / SECOND)
        return self.control.wrench(q, np.concatenate([base.twist, qd_m]), reference, period, qdd_m)

    def model_parameters(self, q: Floats, now: int) -> Floats:
        """Return the present parameters of base and arm, (8 + 6 n,).

        Used gas is subtracted, and a held body is added.

        Args:
            q: (3 + n,) state.
            now: time [ns].
        """
        p = self.arm.vector()
        if self.holds_target and self.place is None and (target := self.target.valid_value(now)):
            self.place = payload_pose(p, q, target.extrapolate(self.target.age(now)).pose)
        p[layout.MASS] -= self.propellant_used
        held, place = self.measured or (self.assumed_target, self.place)
        return p if place is None else with_payload(p, held, place)

    def publish(self, wrench: Floats) -> None:
        """Publish force along the base's axes [N] and torque about its origin [N m]."""
        message = WrenchStamped()
        message.header.stamp = to_time(self.now())
        message.header.frame_id = self.settings.base_frame
        message.wrench.force.x, message.wrench.force.y, message.wrench.torque.z = map(float, wrench)
        self.wrench.publish(message)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        held = self.place is not None or self.measured is not None
        values = {"holds the target": held, "propellant used [kg]": self.propellant_used}
        if self.problem:
            effect = "joints assumed at rest" if self.active else "thrusters idle"
            return Health(WARN, f"{effect}: {self.problem}", values)
        if self.active:
            return Health(OK, "following base/trajectory", values)
        reason = self.trajectory.problem(self.now()) or "base/trajectory has no points"
        return Health(OK, f"thrusters idle: {reason}", values)


if __name__ == "__main__":
    sys.exit(main())
