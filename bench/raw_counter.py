"""Peer of the recorder: subscribes to the same serialized messages, but only counts them."""

import json
import sys
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fss_arm_bags.definitions import message_class
from fss_arm_bags.record_node import matching_qos
from fss_arm_ros.run import run


class CounterNode(Node):
    """Counts the messages of all topics; prints the counts, and those before the first /clock."""

    def __init__(self) -> None:
        super().__init__("raw_counter")
        self.counts: dict[str, int] = {}
        self.before_clock: dict[str, int] = {}
        self.create_timer(0.2, self.discover, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def discover(self) -> None:
        """Subscribe to new topics."""
        for topic, (msgtype, *_) in self.get_topic_names_and_types():
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            if topic not in self.counts and offered and "/_" not in topic:
                self.counts[topic] = 0
                callback = self.on_clock if topic == "/clock" else partial(self.on_message, topic)
                kind = message_class(msgtype)
                self.create_subscription(kind, topic, callback, matching_qos(offered), raw=True)

    def on_message(self, topic: str, _: bytes) -> None:
        """Count a message."""
        self.counts[topic] += 1

    def on_clock(self, _: bytes) -> None:
        """Count a /clock message; store the counts before the first one."""
        self.before_clock = self.before_clock or dict(self.counts)
        self.counts["/clock"] += 1

    def close(self) -> None:
        """Print the counts by topic."""
        print(json.dumps([self.counts, self.before_clock]), flush=True)


def main() -> int:
    return run(CounterNode)


if __name__ == "__main__":
    sys.exit(main())
