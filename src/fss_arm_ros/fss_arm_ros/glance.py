"""A topic that is looked at when its last message is wanted.

Poses come a hundred times a second, and who needs one of them five times a second is woken by all.
"""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from fss_arm_ros.door import Door
from fss_arm_ros.ear import OutsideExecutors
from fss_arm_ros.qos import LAST


class Glance:
    """One topic, whose messages wake nobody.

    Args:
        node: whose subscription it is.
        kind: of message.
        topic: its name.
        take: what to do with a message.
    """

    def __init__(self, node: Node, kind: type, topic: str, take: Callable[[Any], None]) -> None:
        self._door, self._kind, self._take = Door(node, kind, topic), kind, take
        self._subscription = node.create_subscription(
            kind, topic, take, LAST, callback_group=OutsideExecutors(), raw=True
        )

    def look(self) -> None:
        """Take the last message, if one has come since the last look."""
        with self._subscription.handle:
            taken = self._subscription.handle.take_message(self._kind, True)
        if taken and (message := self._door.opened(taken[0])) is not None:
            self._take(message)
