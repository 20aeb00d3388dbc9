"""Process with the arm's node and its links' nodes, for the least delay of streams."""

import sys

from rclpy.node import Node

from fss_arm_driver import links_node
from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.programs import driver as main
from fss_arm_driver.settings import DriverSettings


def make_nodes() -> list[Node]:
    """Create the arm's node and its links' nodes in one process, for the least delay of streams.

    The arm's commands are not published on link_<i>/command, but each link still receives those
    of other publishers from there.
    """
    links = links_node.make_nodes(DriverSettings)
    local = {link.settings.link: link.on_command for link in links}
    return [*links, ArmNode(DriverSettings, local)]


if __name__ == "__main__":
    sys.exit(main())
