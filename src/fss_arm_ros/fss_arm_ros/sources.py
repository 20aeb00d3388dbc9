"""Who else publishes what a node measures by: two sources of one topic would be mixed.

ROS hands messages of a topic on whoever they are from: a second test bed, or a replay beside the
real thing, turns measurements into nonsense. The graph knows who they are.
"""

from collections.abc import Iterable

from rclpy.node import Node

from fss_arm_ros.validation import validators

#: Types that say how things are. Commands have many who may give them, and take turns.
MEASURED = {
    "BaseTelemetry", "GripperState", "Imu", "JointState", "LinkTelemetry", "Odometry",
    "PoseStamped",
}  # fmt: skip
TELEMETRY = "/telemetry"  # of a link, whose driver publishes its joint, too


def rivals(node: Node) -> str:
    """Topics of a node with more sources than one, and their names; empty: there are none."""
    found = []
    for each in validators(node):
        if each.kind.__name__ not in MEASURED or each.topic.endswith("commands"):
            continue
        sources = {
            (info.node_name, info.node_namespace)
            for info in node.get_publishers_info_by_topic(each.topic)
        }
        if len(sources) > 1 and not _each_its_own(node, sources):
            names = sorted(f"{space.rstrip('/')}/{name}" for name, space in sources)
            found.append(f"{each.topic} has {len(names)} sources: {', '.join(names)}")
    return "; ".join(found)


def _each_its_own(node: Node, sources: Iterable[tuple[str, str]]) -> bool:
    """Whether they are drivers of different links, which share joint_states."""
    links: set[str] = set()
    for name, space in sources:
        try:
            topics = node.get_publisher_names_and_types_by_node(name, space)
        except RuntimeError:  # it is gone meanwhile
            continue
        own = {topic for topic, _ in topics if topic.endswith(TELEMETRY)}
        if not own or own & links:
            return False
        links |= own
    return True
