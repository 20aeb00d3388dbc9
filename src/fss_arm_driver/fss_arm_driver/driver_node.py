"""The arm's node and its links' nodes in one process: what is streamed takes the shortest way."""

import sys
from dataclasses import dataclass

from rclpy.node import Node

from fss_arm_driver import link_node
from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.settings import ArmSettings, LinkSettings
from fss_arm_ros.run import run


@dataclass(frozen=True)
class DriverSettings(ArmSettings, LinkSettings):
    """The parameters of an ArmNode and its LinkNodes; what both have is one."""


def make_nodes() -> list[Node]:
    """The nodes of all links of `urls`, or of one, and that of the arm, which hands them commands.

    Its commands are not on link_<i>/command, but each still takes those of others from there.
    """
    links = link_node.make_nodes(DriverSettings)
    local = {link.settings.link: link.on_command for link in links}
    return [*links, ArmNode(DriverSettings, local)]


def main() -> int:
    """Run as `ros2 run fss_arm_driver driver`."""
    return run(make_nodes, DriverSettings)


if __name__ == "__main__":
    sys.exit(main())
