"""Lockstep: a simulator that publishes /clock waits for the nodes that use it.

Each node reports the simulated time that its executor has reached. Without such reports a node on a
busy computer falls behind, and the same mission ends differently.
"""

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

REACHED_TOPIC = "/sim/reached"
REPORT_PERIOD = 0.05  # simulated [s]
SEARCH_PERIOD = 1.0  # of looking for a simulator that waits [s]
QOS = QoSProfile(depth=1000)  # the subscriber keeps the reports of all nodes together


def report_reached_time(node: Node) -> None:
    """Report the simulated time that a node's executor has reached, once a simulator asks for it.

    One node of each executor is enough. Without `use_sim_time` it warns once if time is simulated.
    """
    uses_clock = node.get_parameter("use_sim_time").value

    def search() -> None:
        if uses_clock and node.count_subscribers(REACHED_TOPIC):
            searching.cancel()
            publisher = node.create_publisher(Header, REACHED_TOPIC, QOS)
            node.create_timer(REPORT_PERIOD, lambda: publisher.publish(reached_time(node)))
        elif not uses_clock and (other := _clock_source(node)):
            searching.cancel()
            node.get_logger().warning(
                f"{other} simulates time, but this node uses the computer's: start it again with "
                "--ros-args -p use_sim_time:=true"
            )

    searching = node.create_timer(
        SEARCH_PERIOD, search, clock=Clock(clock_type=ClockType.STEADY_TIME)
    )


def _clock_source(node: Node) -> str:
    """Return the name of another node that publishes /clock; empty: none, or this node does."""
    found = {info.node_name for info in node.get_publishers_info_by_topic("/clock")}
    return "" if node.get_name() in found else min(found, default="")


def reached_time(node: Node) -> Header:
    """Return the node's present time with its full name."""
    return Header(stamp=node.get_clock().now().to_msg(), frame_id=node.get_fully_qualified_name())
