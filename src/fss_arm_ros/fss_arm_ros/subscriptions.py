"""Subscriptions that no executor handles: polled by their node, or with a thread of their own.

An executor asks all of a node's entities what they have every time that one of them wakes it, some
tenths of a millisecond for a node with services and actions. A node that acts five times a second
need not be woken by each of a hundred poses; and a command to stop need not wait for a turn.
"""

import sys
from collections.abc import Callable
from threading import Thread, main_thread
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fss_arm_ros.qos import LAST
from fss_arm_ros.validation import Validator

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


class PolledSubscription:
    """A topic whose messages wait until the node takes them.

    Args:
        node: whose subscription it is.
        kind: of message.
        topic: its name.
        take: what to do with a message.
        qos: of the subscription, which tells how many wait; by default the last one alone.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, take: Callable[[Any], None],
        qos: QoSProfile = LAST,
    ) -> None:  # fmt: skip
        self._validator, self._take = Validator(node, kind, topic), take
        self._subscription = node.create_subscription(
            kind, topic, take, qos, callback_group=OutsideExecutors(), raw=True
        )

    def poll(self) -> None:
        """Take all messages that have come, oldest first."""
        handle, validator = self._subscription.handle, self._validator
        with handle:
            while taken := handle.take_message(validator.kind, True):
                if (message := validator.message(taken[0])) is not None:
                    self._take(message)


class SubscriptionThread(Thread):
    """Takes a topic's messages the moment they come, in a thread of its own.

    Args:
        node: whose subscription it is; close the thread before it is destroyed.
        kind: of message.
        topic: its name.
        qos: of the subscription.
        take: what to do.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, qos: QoSProfile, take: Callable[[Any], None]
    ) -> None:
        super().__init__()  # no daemon: one that waits in C++ must end before Python does
        self._context, self._take = node.context, take
        self._validator = Validator(node, kind, topic)
        self._failed = node.create_guard_condition(self._raise)
        outside = OutsideExecutors()
        self._ended = node.create_guard_condition(lambda: None, outside)
        self._subscription = node.create_subscription(
            kind, topic, take, qos, callback_group=outside, raw=True
        )
        self._error: Exception | None = None
        self._closing = False
        sys.setswitchinterval(GIVE_WAY)
        self.start()

    def run(self) -> None:
        """Wait and take, until closed."""
        try:
            kind, ended = self._validator.kind, self._ended.handle
            handle = self._subscription.handle
            with ended, handle, self._context.handle:
                waiting = WaitSet(1, 1, 0, 0, 0, 0, self._context.handle)
                while self._goes_on():
                    waiting.clear_entities()
                    waiting.add_subscription(handle)
                    waiting.add_guard_condition(ended)
                    waiting.wait(AWAKE)
                    while (taken := handle.take_message(kind, True)) and self._goes_on():
                        if (message := self._validator.message(taken[0])) is not None:
                            self._take(message)
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
