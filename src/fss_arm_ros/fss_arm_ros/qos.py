"""The QoS profiles of the workspace, and a subscription that matches any publisher of a sensor."""

from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Empty

from fss_arm_ros.subscription_set import unsubscribe
from fss_arm_ros.validation import subscribe

#: Publishers of measurements: bursts must not be lost, and a stalled reader must not stall them.
SENSOR = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)

#: Results and descriptions: who comes late gets the last one.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

#: Subscriptions to a stop, each of them: a reliable one does not hear a best-effort publisher, and
#: a best-effort one is not sent again what got lost. It does no harm to hear a stop twice.
STOPS = (QoSProfile(depth=10), QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))

#: Subscription to what only the last message is wanted of; matches any publisher.
LAST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def command(time_to_live: float) -> QoSProfile:
    """Commands: only the last one, and none that is older than its time to live [s]."""
    return QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        lifespan=Duration(seconds=time_to_live),
    )


COMMAND = command(1.0)


def sensor(*, keep_all: bool = False, best_effort: bool = False) -> QoSProfile:
    """Subscription to measurements; `keep_all` makes a reliable publisher that keeps all wait."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=1000,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
    )


def subscribe_stop(node: Node, topic: str, callback: Callable[[Empty], None]) -> None:
    """Subscribe to a stop, whoever publishes it."""
    unsaid = SubscriptionEventCallbacks(use_default_callbacks=False)  # that one of STOPS is deaf
    for qos in STOPS:
        node.create_subscription(Empty, topic, callback, qos, event_callbacks=unsaid)


def subscribe_sensor(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[[Any], None],
    *,
    keep_all: bool = False,
) -> None:
    """Subscribe reliably, and turn best effort once a publisher shows up that offers no more.

    Best effort matches reliable publishers too, so after the turn all are heard.
    """

    def turn(event: Any) -> None:
        if event.last_policy_kind != QoSPolicyKind.RELIABILITY:
            node.get_logger().warning(f"a publisher of {topic} is not compatible and not heard")
            return
        node.get_logger().info(f"{topic} is published best effort: messages may get lost")
        unsubscribe(node, reliable)
        unreliably = sensor(keep_all=keep_all, best_effort=True)
        subscribe(node, kind, topic, callback, unreliably)

    reliable = subscribe(
        node,
        kind,
        topic,
        callback,
        sensor(keep_all=keep_all),
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=turn),
    )
