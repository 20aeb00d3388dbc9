"""The peer of the recorder: subscribes to everything as it does, serialized, and only counts."""

import json
import sys
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fss_arm_bags.definitions import message_class
from fss_arm_bags.record_node import match
from fss_arm_ros.run import run


class CounterNode(Node):
    """Counts all messages of all topics, and says how many at its end, and before /clock."""

    def __init__(self) -> None:
        super().__init__("raw_counter")
        self.counts: dict[str, int] = {}
        self.early: dict[str, int] = {}
        self.create_timer(0.2, self.discover, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def discover(self) -> None:
        """Subscribe to what is new."""
        for topic, (msgtype, *_) in self.get_topic_names_and_types():
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            if topic not in self.counts and offered and "/_" not in topic:
                self.counts[topic] = 0
                take = self.on_clock if topic == "/clock" else partial(self.take, topic)
                kind = message_class(msgtype)
                self.create_subscription(kind, topic, take, match(offered), raw=True)

    def take(self, topic: str, _: bytes) -> None:
        """Count."""
        self.counts[topic] += 1

    def on_clock(self, _: bytes) -> None:
        """Count, and remember what came before the first."""
        self.early = self.early or dict(self.counts)
        self.counts["/clock"] += 1

    def close(self) -> None:
        """Say how many, by topic."""
        print(json.dumps([self.counts, self.early]), flush=True)


def main() -> int:
    return run(CounterNode)


if __name__ == "__main__":
    sys.exit(main())
