"""Subscriptions that the node's executor does not handle: polled, or in a thread of their own.

Each message that wakes an executor costs some tenths of a millisecond. A node that acts five times
per second need not wake up for each of a hundred poses; and a stop must not wait until the executor
has finished what it is doing.
"""

from collections.abc import Callable, Sequence
from threading import Thread, main_thread
from typing import Any, NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Empty

from fss_arm_ros.qos import NEWEST_ONLY, STOPS
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.subscription_set import UnmanagedGroup, subscribe_bytes
from fss_arm_ros.validation import Validator

CHECK_PERIOD = 1.0  # between two checks if the context or the process has ended [s]


class PolledSubscription:
    """Subscription whose messages wait until the node polls them.

    Args:
        node: owner of the subscription.
        kind: message type.
        topic: topic name.
        callback: called with each valid message.
        qos: of the subscription; its depth is the number of messages that wait (default: the last).
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile = NEWEST_ONLY,
    ) -> None:
        self._validator, self._callback = Validator(node, kind, topic), callback
        self._subscription = node.create_subscription(
            kind, topic, callback, qos, callback_group=UnmanagedGroup(), raw=True
        )

    def poll(self) -> None:
        """Hand over every message received, oldest first."""
        handle, validator = self._subscription.handle, self._validator
        with handle:
            while taken := handle.take_message(validator.kind, True):
                if (message := validator.message(taken[0])) is not None:
                    self._callback(message)


class Topic(NamedTuple):
    """A topic that a SubscriptionThread receives."""

    kind: type
    name: str
    qos: QoSProfile
    callback: Callable[[Any], None]


def stop_topics(callback: Callable[[Empty], None], *names: str) -> list[Topic]:
    """Return topics that receive stops from reliable and from best-effort publishers."""
    return [Topic(Empty, name, qos, callback) for name in names for qos in STOPS]


class SubscriptionThread(Thread):
    """Thread that receives topics for `node`, whatever the node's own executor is doing.

    rclpy has one executor per node, so the subscriptions belong to a hidden node `_NAME_commands`.

    Args:
        node: the node whose messages these are; call `close` before it is destroyed.
        topics: what to receive; callbacks run in this thread.
        purpose: end of the hidden node's name, if `node` has several threads.
    """

    def __init__(self, node: Node, topics: Sequence[Topic], purpose: str = "commands") -> None:
        super().__init__()  # no daemon: a thread that waits in C++ must end before Python does
        self._context = node.context
        self._failed = node.create_guard_condition(self._raise)
        self._error: Exception | None = None
        self._closing = False
        self._receiver = Node(
            f"_{node.get_name()}_{purpose}",
            context=node.context,
            namespace=node.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        for topic in topics:
            self._subscribe(node, topic)
        self._receiver.create_timer(
            CHECK_PERIOD, lambda: None, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._receiver)
        self.start()

    def _subscribe(self, node: Node, topic: Topic) -> None:
        validator = Validator(node, topic.kind, topic.name)  # counted in the node's diagnostics

        def receive(data: bytes) -> None:
            if self._continues() and (message := validator.message(data)) is not None:
                topic.callback(message)

        name = node.resolve_topic_name(topic.name)  # remapped as a topic of `node`
        subscribe_bytes(self._receiver, topic.kind, name, receive, topic.qos)

    def run(self) -> None:
        """Receive until closed."""
        try:
            while self._continues():
                self._executor.spin_once()
        except ExternalShutdownException:
            pass
        except RCLError as error:
            if self._context.ok():  # otherwise it was shut down meanwhile
                self._fail(error)
        except Exception as error:
            self._fail(error)

    def _continues(self) -> bool:
        return not self._closing and self._context.ok() and main_thread().is_alive()

    def _fail(self, error: Exception) -> None:
        self._error = error
        self._failed.trigger()

    def _raise(self) -> None:
        """Raise the thread's error in the node's executor, which ends the node."""
        if self._error:
            raise self._error

    def close(self) -> None:
        """End the thread."""
        if self._closing:
            return
        self._closing = True
        self._executor.wake()
        self.join()
        self._executor.shutdown()
        self._receiver.destroy_node()
