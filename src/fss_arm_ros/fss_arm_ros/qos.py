"""The QoS profiles of the workspace, and a subscription that matches any publisher of a sensor."""

from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy

from fss_arm_ros.subscription_set import unsubscribe
from fss_arm_ros.validation import subscribe

#: Publishers of measurements: bursts must not be lost, and a stalled reader must not stall them.
SENSOR = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)

#: Results and descriptions: a late subscriber receives the last one.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

#: Both subscriptions to a stop: a reliable one does not match a best-effort publisher, and for a
#: best-effort one a lost message is not sent again. Receiving a stop twice does no harm.
STOPS = (QoSProfile(depth=10), QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))

#: Subscription to the newest message only; matches any publisher.
NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def command(time_to_live: float) -> QoSProfile:
    """Return the profile of commands: the newest one, unless older than its time to live [s]."""
    return QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        lifespan=Duration(seconds=time_to_live),
    )


COMMAND = command(1.0)


def sensor(*, keep_all: bool = False, best_effort: bool = False) -> QoSProfile:
    """Return a profile for measurements; with `keep_all`, a reliable publisher waits for us."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=1000,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
    )


def subscribe_sensor(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[[Any], None],
    *,
    keep_all: bool = False,
) -> None:
    """Subscribe reliably; switch to best effort when a best-effort publisher appears.

    Best effort matches both kinds of publishers.
    """

    def switch(event: Any) -> None:
        if event.last_policy_kind != QoSPolicyKind.RELIABILITY:
            node.get_logger().warning(
                f"{topic}: messages of a publisher with incompatible QoS are not received; "
                f"`ros2 topic info --verbose {topic}` shows it"
            )
            return
        node.get_logger().info(f"{topic} is published best effort: messages may be lost")
        unsubscribe(node, reliable)
        unreliably = sensor(keep_all=keep_all, best_effort=True)
        subscribe(node, kind, topic, callback, unreliably)

    reliable = subscribe(
        node,
        kind,
        topic,
        callback,
        sensor(keep_all=keep_all),
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=switch),
    )
