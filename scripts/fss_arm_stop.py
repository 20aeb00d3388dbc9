"""Stop of all vehicles in the graph, or of one, confirmed by each link and base."""

import os
import re
from collections.abc import Iterable
from math import inf
from time import monotonic
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Empty

from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import BaseTelemetry, LinkTelemetry
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import sensor, subscribe_sensor
from fss_base_driver.protocol import BaseState

STOP_PERIOD = 0.05  # from one stop to the next [s]
GRAPH_DISCOVERY_TIME = 0.5  # after its start, a program knows the other nodes [s]
CONFIRM_TIMEOUT = 1.0  # for a known link to report that it has stopped [s]
TOPIC = re.compile(
    r"(?P<namespace>.*)/(?:arm/stop|(?P<link>link_\d+)/(?:telemetry|command)|(?P<base>base)/telemetry)"
)
STOPPED = {LinkTelemetry: State.STOPPED, BaseTelemetry: BaseState.STOPPED}
EMERGENCY = "use the emergency stop"

Answer = tuple[bool, str]  # whether it succeeded, and a message


class Stop:
    """Command that stops all vehicles in the graph, or one, until each link and base confirms.

    A link exists if a node drives or commands it; the node `arm` commands all links of its arm.
    """

    def __init__(self, node: Node, namespace: str | None) -> None:
        self.node = node
        self.namespace = namespace and f"/{namespace.strip('/')}".rstrip("/")
        self.publishers: dict[str, Publisher] = {}
        self.start = self.last_discovery = monotonic()
        self.since = int(node.get_clock().now().nanoseconds)  # by the clock of telemetry's stamps
        self.after: dict[str, float] = {}  # until each link's report [s]; inf: none
        self.publish(node.resolve_topic_name("arm/stop"))
        node.create_subscription(Clock, "/clock", self.on_clock, sensor())

    def publish(self, topic: str) -> None:
        """Publish a stop."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(Empty, topic, 10)
        self.publishers[topic].publish(Empty())

    def on_clock(self, message: Clock) -> None:
        """Use simulated time for the stamps, too."""
        self.since = min(self.since, stamp_ns(message.clock))

    def discover(self) -> None:
        """Publish to all arms, and subscribe to new links."""
        for topic, _ in self.node.get_topic_names_and_types():
            found = TOPIC.fullmatch(topic)
            if not found or self.namespace not in (None, found["namespace"]):
                continue
            part = found["link"] or found["base"]
            part = part and f"{found['namespace']}/{part}"
            if not part:
                self.publish(topic)
            elif part not in self.after and self.node.count_publishers(topic):
                self.watch(part, LinkTelemetry if found["link"] else BaseTelemetry)

    def watch(self, part: str, kind: type) -> None:
        """Record when a link, or a base's board, reports that it has stopped since the start."""
        self.last_discovery, self.after[part] = monotonic(), inf
        stopped = STOPPED[kind]

        def on_telemetry(message: Any) -> None:
            if message.flags & stopped and stamp_ns(message.header.stamp) > self.since:
                self.after[part] = min(self.after[part], monotonic() - self.start)

        subscribe_sensor(self.node, kind, f"{part}/telemetry", on_telemetry)

    def __call__(self, wait: float) -> Answer:
        """Stop; return whether all links confirm, and a message."""
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        while True:
            self.discover()
            until = (now := monotonic()) + STOP_PERIOD
            while now < until:
                executor.spin_once(timeout_sec=until - now)
                now = monotonic()
            silent = [link for link, after in self.after.items() if after == inf]
            if self.after and not silent and now - self.start > GRAPH_DISCOVERY_TIME:
                seconds = max(self.after.values())
                return True, f"{_name_list(self.after)}: stopped after {seconds:.2f} s"
            if silent and now - self.last_discovery > CONFIRM_TIMEOUT:
                stopped = _name_list(self.after.keys() - silent)
                also = f" ({stopped}: stopped)" if stopped else ""
                return False, f"{_name_list(silent)}: stop not confirmed{also}; {EMERGENCY}"
            if not self.after and now - self.start > wait:
                domain = os.environ.get("ROS_DOMAIN_ID") or 0
                return False, f"no link in ROS domain {domain} confirms the stop; {EMERGENCY}"


def vehicles(node: Node) -> list[str]:
    """Return the namespaces that contain a driven arm."""
    topics = [topic for topic, _ in node.get_topic_names_and_types()]
    found = (TOPIC.fullmatch(topic) for topic in topics if node.count_publishers(topic))
    return sorted({one["namespace"] or "/" for one in found if one and one["link"]})


def _name_list(links: Iterable[str]) -> str:
    return ", ".join(sorted(link.lstrip("/") for link in links))
