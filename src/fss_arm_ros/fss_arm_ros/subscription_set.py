"""Subscriptions of one node that an executor handles together.

rclpy's executor rebuilds its wait set on every wake-up, from every entity of every node, and runs
one task per message. A node that receives hundreds of messages per second spends most of its time
there. One `Waitable` (rclpy's extension point for such cases) for all subscriptions of a node makes
the wait set short, and hands over every message received in one task (bench/bench_executor.py
compares the two).
"""

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities, Waitable

MAX_BATCH = 64  # messages of one subscription per wake-up, so that others have their turn
MAX_PENDING = 10_000  # messages of one subscription before a request that may be about them
EVENT_PERIOD = 1.0  # between two looks at QoS events, such as an incompatible publisher [s]
EVENT_WINDOW = 0.05  # duration of one look: a few turns of a busy executor [s]
# An attribute of the node: any other reference would keep the node alive.
ATTRIBUTE = "_subscription_set"


class UnmanagedGroup(CallbackGroup):
    """Callback group of entities that no executor handles by itself."""

    def can_execute(self, entity: Any) -> bool:
        """Return False: executors leave the entity out of their wait sets."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False, as `can_execute`."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no execution has started."""


class EventGroup(CallbackGroup):
    """Callback group of QoS event handlers, which rarely fire: handled once per EVENT_PERIOD.

    The middleware keeps an event until it is taken, so a late look loses none.
    """

    def __init__(self) -> None:
        super().__init__()
        self._opened = -EVENT_PERIOD

    def can_execute(self, entity: Any) -> bool:
        """Return True during EVENT_WINDOW, once per EVENT_PERIOD."""
        now = time.monotonic()
        if now >= self._opened + EVENT_PERIOD:
            self._opened = now
        return now < self._opened + EVENT_WINDOW

    def beginning_execution(self, entity: Any) -> bool:
        """Return True: handlers need not exclude each other."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


EVENTS = EventGroup()


def relax_events(node: Node) -> None:
    """Have an executor look at the QoS events of a node's present entities once per second."""
    for waitable in node.waitables:
        if isinstance(waitable, EventHandler):
            waitable.callback_group = EVENTS


class SubscriptionSet(Waitable):
    """Subscriptions of `node`, to which messages are handed over as bytes, in order of arrival.

    Subscriptions may only be added and removed in the executor's thread.
    """

    def __init__(self, node: Node) -> None:
        super().__init__(MutuallyExclusiveCallbackGroup())
        self._group = UnmanagedGroup()
        self._subscriptions: list[Subscription] = []
        self._waiting: list[tuple[int, Subscription]] = []
        self._ready: list[Subscription] = []
        self._in_use = ExitStack()
        node.add_waitable(self)

    def add(
        self,
        node: Node,
        kind: type,
        topic: str,
        callback: Callable[[bytes], None],
        qos: QoSProfile | int,
        **options: Any,
    ) -> Subscription:
        """Create a subscription of `node`; options as of `Node.create_subscription`."""
        subscription = node.create_subscription(
            kind, topic, callback, qos, callback_group=self._group, raw=True, **options
        )
        for handler in subscription.event_handlers:
            handler.callback_group = EVENTS
        self._subscriptions.append(subscription)
        return subscription

    def remove(self, subscription: Subscription) -> None:
        """Forget a subscription, which is about to be destroyed."""
        self._subscriptions.remove(subscription)

    def receive(self, subscriptions: list[Subscription], limit: int = MAX_BATCH) -> None:
        """Hand over the messages received, at most `limit` of each subscription."""
        for subscription in subscriptions:
            for _ in range(limit):
                if subscription not in self._subscriptions:  # removed by a callback
                    break
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                subscription.callback(taken[0])

    def receive_all(self) -> None:
        """Hand over every message received up to now, at most MAX_PENDING of each subscription."""
        for subscription in tuple(self._subscriptions):
            self.receive([subscription], MAX_PENDING)

    def __enter__(self) -> None:
        """Keep the subscriptions alive while an executor waits for them."""
        self._in_use = ExitStack()
        for subscription in self._subscriptions:
            self._in_use.enter_context(subscription.handle)

    def __exit__(self, *error: object) -> None:
        """Allow the subscriptions to be destroyed."""
        self._in_use.close()

    def get_num_entities(self) -> NumberOfEntities:
        """Return the number of entities in the wait set."""
        return NumberOfEntities(num_subs=len(self._subscriptions))

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add the subscriptions to the executor's wait set."""
        self._waiting = [
            (wait_set.add_subscription(subscription.handle), subscription)
            for subscription in self._subscriptions
        ]

    def is_ready(self, wait_set: Any) -> bool:
        """Return True if a subscription has received a message."""
        self._ready = [
            subscription
            for index, subscription in self._waiting
            if wait_set.is_ready("subscription", index)
        ]
        return bool(self._ready)

    def take_data(self) -> list[Subscription]:
        """Return the subscriptions that have received messages."""
        return self._ready

    async def execute(self, taken_data: list[Subscription]) -> None:
        """Hand over the messages of the subscriptions that are ready."""
        self.receive(taken_data)


def subscribe_bytes(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[[bytes], None],
    qos: QoSProfile | int,
    **options: Any,
) -> Subscription:
    """Create a subscription in the set of `node`; its callback gets each message as bytes."""
    if ATTRIBUTE not in vars(node):
        vars(node)[ATTRIBUTE] = SubscriptionSet(node)
    subscriptions: SubscriptionSet = vars(node)[ATTRIBUTE]
    return subscriptions.add(node, kind, topic, callback, qos, **options)


def unsubscribe(node: Node, subscription: Subscription) -> None:
    """Destroy a subscription made by `subscribe_bytes`."""
    vars(node)[ATTRIBUTE].remove(subscription)
    node.destroy_subscription(subscription)


def receive_pending(node: Node) -> None:
    """Hand over every message that `node` has received: before it answers a request, say.

    An executor gives no order between a request and the messages that arrived before it.
    """
    if subscriptions := vars(node).get(ATTRIBUTE):
        subscriptions.receive_all()
