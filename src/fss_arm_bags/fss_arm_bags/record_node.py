"""Node that records every topic into a rosbag2 (MCAP) bag."""

import sys
from collections import Counter, deque
from functools import partial
from pathlib import Path
from shutil import disk_usage
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fss_arm_bags.definitions import NotInstalledError, message_class
from fss_arm_bags.programs import record as main
from fss_arm_bags.recorder import Limits, Recording
from fss_arm_bags.settings import RecordSettings
from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.source_version import source_version
from fss_arm_ros.subscription_set import subscribe_bytes, unsubscribe

MEGABYTE = 1_000_000
LIMITS = Limits(size=2000 * MEGABYTE, span=3600 * SECOND)  # of a bag
MIN_FREE_SPACE = 1000  # free disk space below which a warning is published [MB]
MAX_EARLY_MESSAGES = 1000  # latched, kept until the first time of receipt is known


class RecordNode(Node):
    """Node that records topics, as they appear, into the next bags of a folder.

    In a namespace it records the topics of that namespace and those that all vehicles share;
    otherwise it records all topics.

    Hidden topics (a part of the name starts with `_`, as those of actions) are left out.
    At most the last second is lost when the node is killed. The time of receipt is the node's
    time, with use_sim_time that of /clock. Before the first /clock only latched messages are
    kept; they are recorded as received after it.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("record", **options)
        settings = self.settings = declare(self, RecordSettings)
        self.topics = {self.resolve_topic_name(topic) for topic in settings.topics}
        names = settings.namespace, *filter(None, settings.shared)
        self.prefixes = [f"/{name.strip('/')}".rstrip("/") for name in names]
        try:
            self.recording = Recording(Path(settings.output), LIMITS)
        except OSError as error:  # a write does not know its file
            error.filename = error.filename or settings.output
            raise
        self.subscribed: dict[str, Subscription] = {}
        self.unknown_types: set[str] = set()
        self.counts: Counter[str] = Counter()
        self.commit = source_version()
        self.disk_failed = False  # the disk is full or gone
        self.early_messages: deque[tuple[str, bytes]] = deque(maxlen=MAX_EARLY_MESSAGES)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self.discover, clock=steady)
        self.create_timer(0.5, self.flush, clock=steady)
        self.get_logger().info(f"recording to {self.recording.path}")
        Diagnostics(self, self.health)

    def discover(self) -> None:
        """Subscribe to new topics, and again to topics whose publishers need another QoS."""
        for topic, (msgtype, *_) in self.get_topic_names_and_types():
            if topic in self.unknown_types or "/_" in topic or not self.is_wanted(topic):
                continue
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            current = [self.subscribed[topic].qos_profile] if topic in self.subscribed else []
            if offered and matching_qos(offered + current) not in current:
                self.subscribe(topic, msgtype, offered + current)

    def is_wanted(self, topic: str) -> bool:
        """Return True if a topic is to be recorded."""
        if self.topics:
            return topic in self.topics
        return any(topic == name or topic.startswith(f"{name}/") for name in self.prefixes)

    def subscribe(self, topic: str, msgtype: str, offered: list[QoSProfile]) -> None:
        """Subscribe to a topic; replace a subscription that does not match all publishers."""
        try:
            kind = message_class(msgtype)
            if topic not in self.recording.topics:
                self.recording.add(topic, msgtype, offered)
        except NotInstalledError as error:
            self.unknown_types.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        if topic in self.subscribed:
            unsubscribe(self, self.subscribed[topic])
        callback = partial(self.record_message, topic)
        self.subscribed[topic] = subscribe_bytes(self, kind, topic, callback, matching_qos(offered))

    def record_message(self, topic: str, data: bytes) -> None:
        """Record one serialized message."""
        if receipt := self.get_clock().now().nanoseconds:
            self.write_early_messages(receipt)
            self.write(receipt, topic, data)
        elif self.subscribed[topic].qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self.early_messages.append((topic, data))

    def write_early_messages(self, receipt: int) -> None:
        """Write the messages received before the first /clock, once the time is known."""
        while receipt and self.early_messages:
            self.write(receipt, *self.early_messages.popleft())

    def write(self, receipt: int, topic: str, data: bytes) -> None:
        """Write one serialized message."""
        self.counts[topic] += self.recording.write(topic, receipt, data)

    def flush(self) -> None:
        """Write pending data to the operating system; log a disk error once."""
        self.write_early_messages(self.get_clock().now().nanoseconds)
        try:
            self.recording.flush()
        except OSError as error:
            if not self.disk_failed:
                self.get_logger().error(
                    f"cannot write {self.recording.path}: {error.strerror}; retrying"
                )
            self.disk_failed = True
            return
        if self.disk_failed:
            self.get_logger().warning(
                f"writing {self.recording.path} again; {self.recording.lost} messages were lost"
            )
        self.disk_failed = False

    def health(self) -> Health:
        """Return the diagnostic status: bag, free space, commit and number of messages by topic."""
        free = disk_usage(self.recording.folder).free / MEGABYTE
        values = {"bag": self.recording.path, "free [MB]": free, "commit": self.commit}
        values |= {"messages": self.counts.total(), "lost": self.recording.lost, **self.counts}
        if self.recording.failure:
            return Health(ERROR, f"cannot write: {self.recording.failure.strerror}", values)
        if self.get_clock().now().nanoseconds == 0:
            return Health(WARN, "waiting for /clock", values)
        if free < MIN_FREE_SPACE:
            return Health(WARN, f"only {free:.0f} MB are free on the disk", values)
        if self.recording.lost:
            return Health(WARN, f"{self.recording.lost} messages were lost", values)
        return Health(OK, f"recording {len(self.recording.topics)} topics", values)

    def close(self) -> None:
        """Close the bag; exit with an error if the disk is full or gone."""
        self.write_early_messages(self.get_clock().now().nanoseconds)
        try:
            self.recording.close()
        except OSError as error:
            self.recording.abort()
            raise SystemExit(
                f"cannot write {self.recording.path}: {error.strerror}; earlier messages "
                f"are saved, {self.recording.lost} are lost"
            ) from None


def matching_qos(offered: list[QoSProfile]) -> QoSProfile:
    """Return the best QoS that all offers match, with KEEP_ALL: a replay waits for the recorder."""
    latched = all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offered)
    reliable = all(o.reliability == ReliabilityPolicy.RELIABLE for o in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


if __name__ == "__main__":
    sys.exit(main())
