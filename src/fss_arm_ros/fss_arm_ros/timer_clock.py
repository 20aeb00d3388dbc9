"""The clock that a node's timers keep."""

from rclpy.clock import Clock, ClockType
from rclpy.node import Node


def timer_clock(node: Node) -> Clock:
    """Simulated time if the node uses it, else a clock that nobody sets.

    A timer that keeps the system's clock stands still for as long as that is set back
    (ros2/rclpy#1490).
    """
    if node.get_parameter("use_sim_time").value:
        return node.get_clock()
    return Clock(clock_type=ClockType.STEADY_TIME)
