"""Detection of measurement topics with several publishers.

ROS delivers messages of a topic from every publisher: a second test bed, or a replay beside the
hardware, would corrupt the measurements.
"""

from collections.abc import Iterable

from rclpy.node import Node

from fss_arm_ros.validation import validators

#: Types of measurements. Commands may have several publishers.
MEASURED = {
    "BaseTelemetry",
    "GripperState",
    "Imu",
    "JointState",
    "LinkTelemetry",
    "Odometry",
    "PoseStamped",
}
TELEMETRY = "/telemetry"  # end of a topic of a link; its driver publishes joint_states, too


def duplicate_publishers(node: Node) -> str:
    """Return a sentence on subscribed topics with several publishers; empty if there are none."""
    found = []
    for each in validators(node):
        if each.kind.__name__ not in MEASURED or each.topic.endswith("commands"):
            continue
        sources = {
            (info.node_name, info.node_namespace)
            for info in node.get_publishers_info_by_topic(each.topic)
        }
        if len(sources) > 1 and not _are_different_links(node, sources):
            names = sorted(f"{space.rstrip('/')}/{name}" for name, space in sources)
            found.append(f"{each.topic} has {len(names)} sources: {', '.join(names)}")
    return "; ".join(found)


def _are_different_links(node: Node, sources: Iterable[tuple[str, str]]) -> bool:
    """Return True if the sources are drivers of different links, which share joint_states."""
    links: set[str] = set()
    for name, space in sources:
        try:
            topics = node.get_publisher_names_and_types_by_node(name, space)
        except RuntimeError:  # it has gone in the meantime
            continue
        own = {topic for topic, _ in topics if topic.endswith(TELEMETRY)}
        if not own or own & links:
            return False
        links |= own
    return True
