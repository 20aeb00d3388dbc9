"""The clock of a node's timers."""

from rclpy.clock import Clock, ClockType
from rclpy.node import Node


def timer_clock(node: Node) -> Clock:
    """Return the simulated clock if the node uses it, otherwise the steady clock.

    A timer on the system clock stops for as long as that is set back (ros2/rclpy#1490).
    """
    if node.get_parameter("use_sim_time").value:
        return node.get_clock()
    return Clock(clock_type=ClockType.STEADY_TIME)
