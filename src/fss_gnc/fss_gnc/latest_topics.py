"""Topics whose messages wait until a node polls them, in its own period."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import NEWEST_ONLY
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.validation import validators
from fss_gnc.latest import Latest


class LatestTopics:
    """Subscriptions of a node, polled together."""

    def __init__(self, node: Node) -> None:
        self._node, self._subscriptions = node, list[PolledSubscription]()

    def subscribe(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile = NEWEST_ONLY
    ) -> None:
        """Call back with each valid message; a ValueError rejects the message."""

        def receive(message: Any) -> None:
            try:
                callback(message)
            except ValueError as error:
                self.reject(topic, error)

        self._subscriptions.append(PolledSubscription(self._node, kind, topic, receive, qos))

    def store(self, kind: type, topic: Latest[Any], read: Callable[[Any], Any]) -> None:
        """Keep the newest valid message of a topic, as `read` converts it, with its stamp."""
        self.subscribe(kind, topic.name, lambda m: topic.store(stamp_ns(m.header.stamp), read(m)))

    def reject(self, topic: str, error: ValueError) -> None:
        """Count and log a rejected message, as the validation rule of its type does."""
        next(one for one in validators(self._node) if one.topic == topic).refuse(str(error))

    def poll(self) -> None:
        """Hand over every message received since the last call."""
        for subscription in self._subscriptions:
            subscription.poll()
