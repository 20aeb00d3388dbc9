"""Arms link 1, turns it, and sees its joint."""

import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from fss_arm_msgs.msg import LinkCommand
from fss_arm_ros.qos import COMMAND, subscribe_sensor


class TurnPerson(Node):
    """Turns to the end of the range at a rate [rad/s]; in force for longer than that takes."""

    def __init__(self, rate=0.2):
        super().__init__("person")
        self.rate, self.joint, self.positions, self.health = rate, None, [], {}
        self.commanded = 0.0
        subscribe_sensor(self, JointState, "joint_states", self.on_joint)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_health, 10)
        self.arming = self.create_client(SetBool, "link_1/arm")
        self.commands = self.create_publisher(LinkCommand, "link_1/command", COMMAND)

    def on_joint(self, joint):
        self.joint = joint
        self.positions.append(joint.position[0])

    def on_health(self, diagnostics):
        status = diagnostics.status[0]
        self.health[status.hardware_id] = status

    def turn(self):
        """Now and again: a driver that sends much takes no notice of a few refused datagrams."""
        if time.monotonic() > self.commanded + 0.2:
            self.commanded = time.monotonic()
            command = LinkCommand(mode=LinkCommand.POSITION, set_point=1.5, time_to_live=60.0)
            command.max_velocity = self.rate
            self.commands.publish(command)

    def turning(self):
        """Command the turn; return True if the joint turns."""
        self.turn()
        return self.joint is not None and self.joint.velocity[0] > 0.75 * self.rate
