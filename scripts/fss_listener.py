"""Node that receives what the status shows: measurements, results and reports of nodes."""

import time
from collections import deque
from dataclasses import dataclass, field
from math import degrees
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from fss_arm_bags.definitions import MEASUREMENTS, NotInstalledError, message_class
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.subscription_set import subscribe_bytes

BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
RATE_WINDOW = 2.0  # over which rates are averaged [s]
REPORT_TIMEOUT = 3.0  # older reports of a node are not shown [s]
MAX_READINGS = 64  # messages of joint_states kept; each link publishes its own


@dataclass
class Received:
    """Messages received on a topic, and their rate."""

    kind: Any
    recent: deque[bytes] = field(default_factory=lambda: deque(maxlen=MAX_READINGS))
    since: float = field(default_factory=time.monotonic)
    times: deque[float] = field(default_factory=deque)  # within the last RATE_WINDOW [s]

    def add(self, data: bytes) -> None:
        """Count a message and keep it; it is deserialized only when it is shown."""
        if self.kind is not JointState:  # any other message is complete by itself
            self.recent.clear()
        self.recent.append(data)
        self.times.append(time.monotonic())

    def rate(self) -> float:
        """Return the rate of messages [Hz]."""
        now = time.monotonic()
        while self.times and self.times[0] < now - RATE_WINDOW:
            self.times.popleft()
        return len(self.times) / min(RATE_WINDOW, now - self.since)

    def messages(self) -> list[Any]:
        """Return the messages that contain the present state, the newest last."""
        return [deserialize_message(data, self.kind) for data in self.recent]


class Listener(Node):
    """Node that subscribes to everything shown."""

    def __init__(self, namespace: str = "") -> None:
        super().__init__("status", start_parameter_services=False, enable_rosout=False)
        self.prefix = f"/{namespace}/".replace("//", "/")  # of all names shown
        self.measured: dict[str, Received] = {}
        self.results: dict[str, Received] = {}
        self.reports: dict[str, tuple[float, DiagnosticStatus]] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_report, 100)
        self.create_timer(0.2, self.discover)

    def discover(self) -> None:
        """Subscribe to measurements, and to results (messages with a verdict)."""
        for topic, (msgtype, *_) in self.get_topic_names_and_types():
            if topic in self.measured or topic in self.results or not topic.startswith(self.prefix):
                continue
            if msgtype in MEASUREMENTS:
                self.subscribe(self.measured, topic, msgtype, BEST_EFFORT)
            elif msgtype.startswith("fss_arm_msgs/msg/"):
                self.subscribe(self.results, topic, msgtype, LATCHED)

    def subscribe(
        self, into: dict[str, Received], topic: str, msgtype: str, qos: QoSProfile
    ) -> None:
        """Subscribe to a topic; of results, only to those with a verdict."""
        try:
            kind = message_class(msgtype)
        except NotInstalledError:
            return
        if into is self.results and not (hasattr(kind, "verdict") or hasattr(kind, "calibration")):
            return
        into[topic] = Received(kind)
        subscribe_bytes(self, kind, topic, into[topic].add, qos)

    def on_report(self, message: DiagnosticArray) -> None:
        """Keep each node's last report, under its name in a configuration: `fss2/arm`."""
        for status in message.status:
            if status.name.startswith(self.prefix) or "/" not in status.name:
                self.reports[status.name.lstrip("/")] = time.monotonic(), status

    def angles(self, vehicle: str) -> dict[str, float]:
        """Return the joints' readings [deg] in a namespace, such as `/fss2`, by name."""
        received = self.measured.get(f"{vehicle}/joint_states")
        return {
            name: degrees(q)
            for message in (received.messages() if received and received.rate() else ())
            for name, q in zip(message.name, message.position, strict=False)
        }

    def report(self, name: str) -> DiagnosticStatus | None:
        """Return a node's last report, unless it is older than REPORT_TIMEOUT."""
        then, status = self.reports.get(name, (0.0, None))
        return status if time.monotonic() - then < REPORT_TIMEOUT else None
