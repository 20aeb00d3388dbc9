"""Lockstep of the simulated time with the nodes that use it."""

from threading import RLock

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.lockstep import QOS, REACHED_TOPIC
from fss_arm_ros.validation import subscribe
from fss_sim.timeline import Timeline

CHECK_PERIOD = 1.0  # of looking for nodes that have ended [s]


def wait_for_nodes(node: Node, lock: RLock, timeline: Timeline) -> None:
    """Have a timeline wait for each node that reports the time that it has reached."""

    def record(message: Header) -> None:
        with lock:
            timeline.record_node(message.frame_id, stamp_ns(message.stamp))

    def forget_ended_nodes() -> None:
        publishers = node.get_publishers_info_by_topic(REACHED_TOPIC)
        names = {f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in publishers}
        with lock:
            timeline.nodes.keep(names)

    subscribe(node, Header, REACHED_TOPIC, record, QOS)
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    node.create_timer(CHECK_PERIOD, forget_ended_nodes, clock=steady)
