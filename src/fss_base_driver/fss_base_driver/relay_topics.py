"""Setting `relays` of the node `mocap`, with topic names as ROS resolves them."""

from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.validate_topic_name import validate_topic_name

from fss_arm_model.settings import SettingError
from fss_base_driver.mocap import Relay


def read_relay(node: Node, text: str) -> Relay:
    """Return the relay of an entry [SUBJECT=]TOPIC.

    Raises:
        SettingError: the topic's name is invalid.
    """
    subject, _, topic = text.rpartition("=")
    try:
        validate_topic_name(topic)
        return Relay(subject, node.resolve_topic_name(topic))
    except NameValidationException as error:
        raise SettingError(f"relays: {topic!r} is no valid topic name: {error}") from None
