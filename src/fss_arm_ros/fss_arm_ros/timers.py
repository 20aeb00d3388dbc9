"""Timers of a node: their clock, and a timer that fires once."""

from collections.abc import Callable
from threading import Lock
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node


def timer_clock(node: Node) -> Clock:
    """Return the simulated clock if the node uses it, otherwise the steady clock.

    A timer on the system clock stops for as long as that is set back (ros2/rclpy#1490).
    """
    if node.get_parameter("use_sim_time").value:
        return node.get_clock()
    return Clock(clock_type=ClockType.STEADY_TIME)


class OneShotTimer:
    """Timer that fires once after each start, and that any thread may start and cancel.

    rclpy's executor raises an error if another thread cancels a timer that it is about to call.
    Therefore only the timer's own callback does so.

    Args:
        node: the node whose executor calls `callback`.
        callback: called once the timer fires.
        clock: clock of the delay.
    """

    def __init__(self, node: Node, callback: Callable[[], Any], clock: Clock) -> None:
        self._callback, self._lock, self._is_due = callback, Lock(), False
        self._timer = node.create_timer(1.0, self._fire, clock=clock, autostart=False)

    def start(self, delay: int) -> None:
        """Fire after a delay [ns]; a start before that is replaced."""
        with self._lock:
            self._is_due = True
            self._timer.timer_period_ns = delay
            self._timer.reset()

    def cancel(self) -> None:
        """Do not fire."""
        with self._lock:
            self._is_due = False

    def _fire(self) -> None:
        with self._lock:
            self._timer.cancel()
            is_due, self._is_due = self._is_due, False
        if is_due:
            self._callback()
