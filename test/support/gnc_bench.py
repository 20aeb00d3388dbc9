"""Publishers of the inputs of fss_gnc's nodes: base, target, joints, gripper, tank."""

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from fss_arm_msgs.msg import GripperState
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.qos import SENSOR

FOLDED = (1.5, -1.5, -1.5, 1.5)
RATE = 50.0  # [1/s]


class FakeCraft(Node):
    """Node that publishes these inputs, except the topics in `silent`.

    With `time` [ns] it publishes /clock, too, which advances by 20 ms with each report.
    """

    def __init__(self, time=None, namespace=""):
        super().__init__("fake_craft", namespace=namespace)
        self.time, self.clock = time, time and self.create_publisher(Clock, "/clock", 10)
        self.pose, self.twist = np.zeros(3), np.zeros(3)  # in the world
        self.target = None  # (pose, twist)
        self.q, self.qd = np.array(FOLDED), np.zeros(4)
        self.holds, self.propellant = False, 0.1
        self.silent, self.late = set(), 0.0  # topics; age of stamps [s]
        kinds = {
            "base/state": Odometry,
            "target/state": Odometry,
            "arm/joint_states": JointState,
            "gripper/state": GripperState,
            "base/propellant": Float64,
        }
        self.topics = {
            name: self.create_publisher(kind, name, SENSOR) for name, kind in kinds.items()
        }
        self.create_timer(1.0 / RATE, self.report)

    def now(self):
        return self.time or self.get_clock().now().nanoseconds

    def report(self):
        if self.time:
            self.time += round(SECOND / RATE)
            self.clock.publish(Clock(clock=to_time(self.time)))
        stamp = to_time(self.now() - round(self.late * SECOND))
        messages = {
            "base/state": odometry(self.pose, self.twist),
            "arm/joint_states": JointState(
                name=[f"joint_{i}" for i in range(1, 5)],
                position=list(map(float, self.q)),
                velocity=list(map(float, self.qd)),
                effort=[0.1, -0.4, 0.2, 0.0],
            ),
            "gripper/state": GripperState(holds=self.holds),
        }
        if self.target:
            messages["target/state"] = odometry(*self.target)
        for name, message in messages.items():
            message.header.stamp = stamp
            if name not in self.silent:
                self.topics[name].publish(message)
        self.topics["base/propellant"].publish(Float64(data=self.propellant))


def odometry(pose, twist):
    """Pose and twist in the world, as the type has them."""
    x, y, heading = map(float, pose)
    message = Odometry()
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = float(np.sin(0.5 * heading))
    message.pose.pose.orientation.w = float(np.cos(0.5 * heading))
    v = complex(*twist[:2]) * np.exp(-1j * heading)
    linear = message.twist.twist.linear
    linear.x, linear.y = float(v.real), float(v.imag)
    message.twist.twist.angular.z = float(twist[2])
    return message
