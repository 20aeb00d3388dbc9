"""Topics whose messages wait until the node takes them.

For a node that looks at what has come when it acts, and not before: an executor's turn for each
message would cost it some tenths of a millisecond.
"""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from fss_arm_ros.door import Door
from fss_arm_ros.ear import OutsideExecutors
from fss_arm_ros.qos import LAST, sensor


class Inbox:
    """Subscriptions of a node, of any publisher, that no executor handles.

    Callbacks get what the rule of the type allows (door.py).
    """

    def __init__(self, node: Node) -> None:
        self._node, self._group = node, OutsideExecutors()
        self._boxes: list[tuple[Subscription, Door, Callable[[Any], None]]] = []

    def listen(
        self, kind: type, topic: str, callback: Callable[[Any], None], last: bool = False
    ) -> None:
        """Have a topic's messages wait, or the last one alone."""
        qos = LAST if last else sensor(best_effort=True)
        subscription = self._node.create_subscription(
            kind, topic, callback, qos, callback_group=self._group, raw=True
        )
        self._boxes.append((subscription, Door(self._node, kind, topic), callback))

    def take(self) -> None:
        """Hand over all messages that have come, topic after topic."""
        for subscription, door, callback in self._boxes:
            with subscription.handle:
                while taken := subscription.handle.take_message(subscription.msg_type, True):
                    if (message := door.opened(taken[0])) is not None:
                        callback(message)
