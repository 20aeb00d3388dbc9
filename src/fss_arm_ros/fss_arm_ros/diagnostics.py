"""A node's health on /diagnostics, once a second."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from fss_arm_ros.sources import rivals
from fss_arm_ros.validation import refusals

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR


class Health(NamedTuple):
    """What a node says about itself: OK, WARN or ERROR, a sentence, and counts by name."""

    level: bytes
    message: str
    values: Mapping[str, Any] = {}


class Diagnostics:
    """Publishes what `health()` returns as one status, at 1 Hz of real time.

    Its name is the node's with its namespace, unless another is given. A new subscriber gets the
    last state at once. Make it last in a node's constructor. Measurements that two others publish
    are named, and logged when that begins.
    """

    def __init__(
        self, node: Node, health: Callable[[], Health], hardware_id: str = "", name: str = ""
    ) -> None:
        self.node, self.health, self.hardware_id = node, health, hardware_id
        self.name = name or node.get_fully_qualified_name()
        self.rivals = ""
        matched = PublisherEventCallbacks(matched=lambda _: self.publish())
        self.publisher = node.create_publisher(
            DiagnosticArray, "/diagnostics", 10, event_callbacks=matched
        )
        # Real time: a simulated clock that stands still is something to report.
        node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish now, out of turn."""
        level, message, values = self.health()
        before, self.rivals = self.rivals, rivals(self.node)
        if self.rivals and self.rivals != before:
            self.node.get_logger().warning(self.rivals)
        if self.rivals:
            level, message = max(level, WARN), f"{self.rivals}; {message}"
        values = {**values, **refusals(self.node)}
        status = DiagnosticStatus(
            level=level,
            name=self.name,
            message=message,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.node.get_clock().now().to_msg()
        self.publisher.publish(array)


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
