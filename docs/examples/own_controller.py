"""Keep the base where it is first seen, and swing joint 1; in the place of control and guidance."""

from contextlib import suppress
from math import atan2, cos, degrees, pi, sin

import rclpy
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

MASS, INERTIA = 20.0, 10.0  # of base and arm, stretched, about its origin [kg], [kg m^2]
STIFFNESS, DAMPING = 0.1, 0.6  # of the base per mass [1/s^2], [1/s]


class OwnController(Node):
    """Commands a wrench at each state of the base, a rate at each of the joints."""

    def __init__(self, **options):
        super().__init__("own_controller", **options)
        self.home = None  # x, y, heading
        self.wrench = self.create_publisher(WrenchStamped, "base/wrench", 1)
        self.rates = self.create_publisher(JointState, "arm/joint_commands", 1)
        self.create_subscription(Odometry, "base/state", self.on_base, 1)
        self.create_subscription(JointState, "arm/joint_states", self.on_joints, 1)

    def on_base(self, state):
        """Draw the base home; unseen, it coasts."""
        p, o, v = state.pose.pose.position, state.pose.pose.orientation, state.twist.twist
        x, y, heading = p.x, p.y, 2.0 * atan2(o.z, o.w)
        if self.home is None:
            self.home = x, y, heading
            place = f"{x:z.3f} m, {y:z.3f} m, {degrees(heading):z.1f} deg"
            self.get_logger().info(f"holding the base at {place}")
        dx, dy, turn = self.home[0] - x, self.home[1] - y, self.home[2] - heading
        c, s, turn = cos(heading), sin(heading), (turn + pi) % (2.0 * pi) - pi
        command = WrenchStamped(header=state.header)
        command.header.stamp, command.header.frame_id = self.get_clock().now().to_msg(), "fss"
        force, torque = command.wrench.force, command.wrench.torque  # along the base's axes
        force.x = MASS * (STIFFNESS * (c * dx + s * dy) - DAMPING * v.linear.x)
        force.y = MASS * (STIFFNESS * (c * dy - s * dx) - DAMPING * v.linear.y)
        torque.z = INERTIA * (STIFFNESS * turn - DAMPING * v.angular.z)
        self.wrench.publish(command)

    def on_joints(self, state):
        """Swing joint 1; the others rest."""
        now = self.get_clock().now()
        aim = 0.1 * sin(0.1e-9 * now.nanoseconds)  # [rad]
        q_1 = state.position[list(state.name).index("joint_1")]
        command = JointState(name=["joint_1"], velocity=[max(-0.01, min(0.01, aim - q_1))])
        command.header.stamp = now.to_msg()
        self.rates.publish(command)


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):  # Ctrl-C
        controller = OwnController()
        controller.get_logger().info("waiting for base/state; Ctrl-C ends")
        rclpy.spin(controller)
