"""Process with the nodes of one link or of several."""

from rclpy.node import Node

from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.settings import LinkSettings
from fss_arm_ros.parameters import declare


def make_nodes(kind: type[LinkSettings] = LinkSettings) -> list[LinkNode]:
    """Create nodes that publish what each link measures and send it commands at a steady rate.

    There is one node for the link of `url`, or one for each of `urls`.
    """
    quiet = {"enable_rosout": False, "start_parameter_services": False}
    # With the last node of a process Fast DDS (2.14) deletes its participant. This was seen to hang
    # while other nodes were being discovered, so one node stays until the links' nodes exist.
    keeper = Node("_begins", use_global_arguments=False, **quiet)
    probe = Node("link", **quiet)
    try:
        s = declare(probe, kind)
        probe.destroy_node()  # `__node` would give the probe the links' name
        links = enumerate(s.urls, 1) if s.urls else [(s.link, s.url)]
        return [LinkNode(number, url, kind=kind) for number, url in links]
    finally:
        keeper.destroy_node()
