"""Choose the topics of a bag to play back, with their names and QoS."""

from collections.abc import Collection, Mapping

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability

from fss_arm_bags.definitions import MEASUREMENTS, RECORDERS
from fss_arm_bags.reader import Topic

ORDERS = ("command", "wrench", "trajectory", "stop")  # last parts of topics that move something
TOLD = "pulses", "health"  # of the thrusters; these topics move nothing
IN_PLACE = ("/robot_description", "/thrusters/pulses")  # played in place, as measurements
OF_ROS = ("/clock", "/rosout", "/parameter_events")


def choose(recorded: Mapping[str, Topic], wanted: Collection[str] = ()) -> dict[str, str]:
    """Return the topics to play, each with the name to play it under.

    Args:
        recorded: the topics of the bags.
        wanted: names of those to play in place; by default all that `played_as` permits.

    Raises:
        ValueError: a wanted topic moves something or is not in the bags.
    """
    chosen = [topic if topic[0] == "/" else f"/{topic}" for topic in wanted]
    for topic in chosen:
        if is_command(topic):
            raise ValueError(f"topics: {topic} moves something and is never played")
        if topic not in recorded:
            raise ValueError(f"topics: {topic} is not in the bags, which have {list(recorded)}")
    if chosen:
        return {topic: topic for topic in chosen}
    names = {topic: played_as(topic, about.msgtype) for topic, about in recorded.items()}
    return {topic: name for topic, name in names.items() if name}


def is_command(topic: str) -> bool:
    """Return True if a topic makes something move; such topics are never played."""
    parts = topic.strip("/").split("/")
    thrusts = "thrusters" in parts and parts[-1] not in TOLD
    return parts[-1] in ORDERS or "arm" in parts or thrusts


def played_as(topic: str, msgtype: str) -> str | None:
    """Return the topic on which a recorded one is played back by default; None: it is not played.

    Computed results are played under recorded/, so that they are not taken for the results of
    the nodes that run now. Topics that ROS and recorders publish about themselves are not played.
    """
    if is_command(topic) or topic in OF_ROS or msgtype.startswith(RECORDERS):
        return None
    if msgtype in MEASUREMENTS or topic.endswith(IN_PLACE):
        return topic
    return f"recorded{topic}"


def is_latched(topic: Topic) -> bool:
    """Return True if a topic was latched (transient local), for late subscribers."""
    return any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in topic.qos)


def profile(topic: Topic) -> QoSProfile:
    """Return the QoS to play a topic with: latched with room for all messages, else KEEP_ALL."""
    reliable = ReliabilityPolicy.RELIABLE
    if is_latched(topic):
        return QoSProfile(
            depth=max(1, topic.messages),
            reliability=reliable,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliable)
