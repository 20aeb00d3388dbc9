"""Node `control`: computes the wrench on the base from its state and its reference.

It publishes nothing, so that the valves close, while base, joints or trajectory are unknown, and
while it follows a trajectory without points. After a pause of this process it holds the base and
ends the goal, because it was not in control meanwhile.
"""

import sys
import time
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from fss_arm_model.arrays import Floats
from fss_arm_msgs.msg import GripperState, MassProperties
from fss_arm_ros.convert import stamp_ns, to_time
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import command, sensor
from fss_arm_ros.timers import timer_clock
from fss_arm_ros.timing import Timing
from fss_gnc import bounds, messages
from fss_gnc.control.base_control import BaseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.latest_topics import LatestTopics
from fss_gnc.programs import control as main

CHECK_PERIOD = 0.1  # between two checks for a stall, also while simulated time is paused [s]


class ControlNode(Node):
    """Publish base/wrench so that the base follows base/trajectory, whatever the arm does."""

    def __init__(self, **options: Any) -> None:
        super().__init__("control", **options)
        self.settings = s = declare(self, ControlSettings)
        self.controller = BaseControl(load_described_arm(self, s.arm), s)
        self.controller.load_kernels()
        self.timing = Timing(s.rate, self)
        self.topics = topics = LatestTopics(self)
        for topic in (self.controller.base, self.controller.target):
            topics.store(Odometry, topic, messages.body)
        n = self.controller.model.arm.n
        topics.store(JointState, self.controller.joints, partial(messages.joints, n=n))
        for kind, name, callback in (
            (MultiDOFJointTrajectory, "base/trajectory", self.on_trajectory),
            (JointTrajectory, "arm/planned", self.on_planned),
            (GripperState, "gripper/state", self.on_gripper),
            (MassProperties, "target/mass_properties", self.on_mass),
            (Float64, "base/propellant", self.on_propellant),
        ):
            qos = sensor(best_effort=True)  # a queue: every message counts
            topics.subscribe(kind, name, callback, qos)
        self.wrench = self.create_publisher(WrenchStamped, "base/wrench", command(0.3))
        self.stall = self.create_publisher(String, "control/stall", 10)
        real_time = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(CHECK_PERIOD, self.check_stall, clock=real_time)
        self.create_timer(1.0 / s.rate, self.tick, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health, timing=self.timing)
        self.get_logger().info(f"subscribed to base/trajectory (joints: {n})")

    def now(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        """Follow a new trajectory from now on; reject it if it is out of bounds."""
        now, stamp = self.now(), stamp_ns(message.header.stamp)
        path = messages.path(message)
        if path is not None:  # a message without points may always close the valves
            bounds.check_stamp(stamp, now, path.end_time, self.settings.timeout)
            bounds.check_reference(path, self.settings.table)
        self.controller.follow(now, stamp, path)

    def on_planned(self, message: JointTrajectory) -> None:
        """Store the rates planned for the joints."""
        arm = self.controller.model.arm
        self.controller.planned.store(*messages.planned_rates(message, arm))

    def on_propellant(self, message: Float64) -> None:
        """Compute the used propellant; a sensor's offset may exceed an empty or full tank."""
        used = self.settings.full_tank - max(message.data, 0.0)
        self.controller.model.propellant_used = max(used, 0.0)

    def on_gripper(self, message: GripperState) -> None:
        """Store whether the target is part of the arm."""
        self.controller.model.set_gripper(message.holds)

    def on_mass(self, message: MassProperties) -> None:
        """Store the held body's mass properties as estimated by the navigation."""
        holds = self.controller.model.holds_target
        self.controller.model.measured = messages.mass_properties(message) if holds else None

    def tick(self) -> None:
        """Publish the wrench for the next period; without one, publish zero once, then nothing.

        Its stamp is taken first: if this program is stopped within a step, the wrench that it
        publishes afterwards is too old for the base's driver.
        """
        stamp = self.now()
        self.check_stall()
        self.topics.poll()
        self.timing.add_step()
        wrench = self.controller.step(self.now())
        if wrench is not None:
            self.publish(stamp, wrench)
        if self.controller.hold.is_asking:
            self.stall.publish(String(data=self.controller.hold.reason))

    def check_stall(self) -> None:
        """After a stall, discard what was received during it, and hold the base."""
        if pause := self.controller.hold.check(time.clock_gettime(time.CLOCK_BOOTTIME)):
            self.topics.poll()
            self.controller.resume(pause)
            self.get_logger().warning(f"{self.controller.hold.reason}: reference dropped")

    def publish(self, stamp: int, wrench: Floats) -> None:
        """Publish force along the base's axes [N] and torque about its origin [N m]."""
        message = WrenchStamped()
        message.header.stamp = to_time(stamp)
        message.header.frame_id = self.settings.base_frame
        message.wrench.force.x, message.wrench.force.y, message.wrench.torque.z = map(float, wrench)
        self.wrench.publish(message)
        self.timing.add_command(self.controller.base.stamp)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        controller, model = self.controller, self.controller.model
        values = {
            "holds the target": model.is_loaded,
            "propellant used [kg]": model.propellant_used,
        }
        is_impaired = controller.problem or controller.hold.reason
        return Health(WARN if is_impaired else OK, controller.status(self.now()), values)


if __name__ == "__main__":
    sys.exit(main())
