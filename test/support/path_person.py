"""Who commands paths, as a process: path NUMBER of links 1 and 2, 10 s long, again and again.

usage: path_person.py NUMBER
"""

import sys

import rclpy
from rclpy.node import Node
from rclpy.time import Duration
from sensor_msgs.msg import JointState

from fss_arm_msgs.msg import LinkCommand, LinkPath
from fss_arm_ros.qos import COMMAND, subscribe_sensor

LINKS = 1, 2
LASTS, WAY, LIVES = 10, 0.5, 2.0  # [s], [rad], [s]


class PathPerson(Node):
    """Gives each link a path from where it is, which begins in a second, and has it followed."""

    def __init__(self, number):
        super().__init__("path_person")
        self.number, self.q = number, {}
        subscribe_sensor(self, JointState, "joint_states", self.see)
        self.paths = {i: self.create_publisher(LinkPath, f"link_{i}/path", 10) for i in LINKS}
        self.commands = {
            i: self.create_publisher(LinkCommand, f"link_{i}/command", COMMAND) for i in LINKS
        }
        self.given = False
        self.create_timer(0.2, self.go_on)

    def see(self, joint):
        self.q[int(joint.name[0].removeprefix("joint_"))] = joint.position[0]

    def go_on(self):
        ears = all(
            p.get_subscription_count() for p in (*self.paths.values(), *self.commands.values())
        )
        if not self.given and (not ears or len(self.q) < len(LINKS)):
            return
        now = self.get_clock().now()
        for i in LINKS:
            if not self.given:
                self.paths[i].publish(self.path(i, now))
            command = LinkCommand(mode=LinkCommand.PATH, path=self.number, time_to_live=LIVES)
            command.header.stamp = now.to_msg()
            self.commands[i].publish(command)
        self.given = True

    def path(self, i, now):
        """Smoothly by WAY."""
        message, s = LinkPath(path=self.number), [k / LASTS for k in range(LASTS + 1)]
        message.header.stamp = (now + Duration(seconds=1)).to_msg()
        message.time = [float(LASTS * x) for x in s]
        message.position = [self.q[i] + WAY * x * x * (3.0 - 2.0 * x) for x in s]
        message.velocity = [WAY * 6.0 * x * (1.0 - x) / LASTS for x in s]
        return message


def main():
    rclpy.init()
    rclpy.spin(PathPerson(int(sys.argv[1])))
