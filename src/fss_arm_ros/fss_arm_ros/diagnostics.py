"""A node's health on /diagnostics."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from fss_arm_ros.sources import duplicate_publishers
from fss_arm_ros.timing import Timing
from fss_arm_ros.validation import refusals

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR


class Health(NamedTuple):
    """Health of a node: level (OK, WARN or ERROR), message, and values by name."""

    level: bytes
    message: str
    values: Mapping[str, Any] = {}


class Diagnostics:
    """Publishes what `health()` returns as one status, every `period` seconds of real time.

    The status has the node's full name unless `name` is given. A new subscriber receives it at
    once. Create it last in a node's constructor. Measurements with several publishers are reported
    as a warning, and logged when they are first found. With `timing`, its values are added.
    """

    def __init__(
        self,
        node: Node,
        health: Callable[[], Health],
        hardware_id: str = "",
        name: str = "",
        period: float = 1.0,
        timing: Timing | None = None,
    ) -> None:
        self.timing, self.node, self.health, self.hardware_id = timing, node, health, hardware_id
        self.name = name or node.get_fully_qualified_name()
        self.duplicates = ""
        matched = PublisherEventCallbacks(matched=lambda _: self.publish())
        self.publisher = node.create_publisher(
            DiagnosticArray, "/diagnostics", 10, event_callbacks=matched
        )
        # Real time: a simulated clock that has stopped must be reported, too.
        node.create_timer(period, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the status now."""
        level, message, values = self.health()
        before, self.duplicates = self.duplicates, duplicate_publishers(self.node)
        if self.duplicates and self.duplicates != before:
            self.node.get_logger().warning(self.duplicates)
        if self.duplicates:
            level, message = max(level, WARN), f"{self.duplicates}; {message}"
        timing = self.timing.values() if self.timing else {}
        values = {**timing, **values, **refusals(self.node)}
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
