"""A thread that takes a topic's messages the moment they come.

An executor asks all of a node's entities what they have every time that one of them wakes it, some
tenths of a millisecond for a node with services and actions. Here a thread waits for one
subscription alone, and the executor does not see it.
"""

import sys
from collections.abc import Callable
from threading import Thread, main_thread
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fss_arm_ros.door import Door

# rclpy keeps these classes in its extension and offers no public names for them.
from rclpy._rclpy_pybind11 import RCLError, WaitSet  # isort: skip

GIVE_WAY = 0.0005  # that another thread of Python may go on when a message has come [s]
AWAKE = 1_000_000_000  # [ns]; so often it sees that its context or the process ends, unless closed


class OutsideExecutors(CallbackGroup):
    """Of entities that no executor handles."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing has begun."""


class Ear(Thread):
    """Calls `take` with each message, in a thread of its own.

    Args:
        node: whose subscription it is; close the ear before it is destroyed.
        kind: of message.
        topic: its name.
        qos: of the subscription.
        take: what to do.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, qos: QoSProfile, take: Callable[[Any], None]
    ) -> None:
        super().__init__()  # no daemon: one that waits in C++ must end before Python does
        self._context, self._kind, self._take = node.context, kind, take
        self._door = Door(node, kind, topic)
        self._failed = node.create_guard_condition(self._raise)
        outside = OutsideExecutors()
        self._ended = node.create_guard_condition(lambda: None, outside)
        self._subscription = node.create_subscription(
            kind, topic, take, qos, callback_group=outside
        )
        self._error: Exception | None = None
        self._closing = False
        sys.setswitchinterval(GIVE_WAY)
        self.start()

    def run(self) -> None:
        """Wait and take, until closed."""
        try:
            ended, handle = self._ended.handle, self._subscription.handle
            with ended, handle, self._context.handle:
                waiting = WaitSet(1, 1, 0, 0, 0, 0, self._context.handle)
                while self._goes_on():
                    waiting.clear_entities()
                    waiting.add_subscription(handle)
                    waiting.add_guard_condition(ended)
                    waiting.wait(AWAKE)
                    while (taken := handle.take_message(self._kind, False)) and self._goes_on():
                        if self._door.lets_in(taken[0]):
                            self._take(taken[0])
        except RCLError:
            if self._context.ok():  # else it was shut down meanwhile
                raise
        except Exception as error:
            self._error = error
            self._failed.trigger()

    def _goes_on(self) -> bool:
        return not self._closing and self._context.ok() and main_thread().is_alive()

    def _raise(self) -> None:
        """Let what went wrong end the node, as if its executor had called."""
        if self._error:
            raise self._error

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        self._ended.trigger()
        self.join()
