"""Choose the topics of a bag to play back, with their names and QoS."""

from collections.abc import Collection, Mapping

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability

from fss_arm_bags.definitions import (
    MEASUREMENTS,
    ROSBAG2_TYPES,
    NotInstalledError,
    definition,
    extends,
    message_class,
)
from fss_arm_bags.reader import Topic, two_versions

COMMANDS = ("command", "wrench", "trajectory", "stop")  # last parts of topics that move something
THRUSTER_REPORTS = "pulses", "health"  # last parts of thruster topics that move nothing
IN_PLACE = ("/robot_description", "/thrusters/pulses")  # played in place, as measurements
ROS_TOPICS = ("/clock", "/rosout", "/parameter_events")


def choose_topics(recorded: Mapping[str, Topic], wanted: Collection[str] = ()) -> dict[str, str]:
    """Return the topics to play, each with the name to play it under.

    Args:
        recorded: the topics of the bags.
        wanted: names of those to play in place; by default all that `playback_name` permits.

    Raises:
        ValueError: a wanted topic moves something or is not in the bags.
    """
    chosen = [topic if topic[0] == "/" else f"/{topic}" for topic in wanted]
    for topic in chosen:
        if is_command(topic):
            raise ValueError(f"topics: {topic} is a command and is never played")
        if topic not in recorded:
            raise ValueError(f"topics: {topic} is not in the bags, which contain {list(recorded)}")
    if chosen:
        return {topic: topic for topic in chosen}
    names = {topic: playback_name(topic, about.msgtype) for topic, about in recorded.items()}
    return {topic: name for topic, name in names.items() if name}


def is_command(topic: str) -> bool:
    """Return True if a topic makes something move; such topics are never played."""
    parts = topic.strip("/").split("/")
    thrusts = "thrusters" in parts and parts[-1] not in THRUSTER_REPORTS
    return parts[-1] in COMMANDS or "arm" in parts or thrusts


def playback_name(topic: str, msgtype: str) -> str | None:
    """Return the topic on which a recorded one is played back by default; None: it is not played.

    Computed results are played under recorded/, so that they are not taken for the results of
    the nodes that run now. Topics that ROS and recorders publish about themselves are not played.
    """
    if is_command(topic) or topic in ROS_TOPICS or msgtype.startswith(ROSBAG2_TYPES):
        return None
    if msgtype in MEASUREMENTS or topic.endswith(IN_PLACE):
        return topic
    return f"recorded{topic}"


def has_installed_version(topic: Topic) -> bool:
    """Return True if a topic's messages are of the installed version of their type.

    Raises:
        NotInstalledError: the type is not installed.
    """
    return topic.hash in ("", definition(topic.msgtype).hash)


def type_problem(topic: Topic) -> str:
    """Return why a topic's messages cannot be published; empty if they can."""
    if topic.mixed:
        return f"the bags {two_versions(topic.msgtype)}"
    try:
        message_class(topic.msgtype)
        if has_installed_version(topic) or extends(topic.msgtype, topic.definition):
            return ""
    except NotInstalledError as error:
        return str(error)
    return f"{topic.msgtype} is installed in another version"


def is_latched(topic: Topic) -> bool:
    """Return True if a topic was latched (transient local), for late subscribers."""
    return any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in topic.qos)


def playback_qos(topic: Topic) -> QoSProfile:
    """Return the QoS to play a topic with: latched with room for all messages, else KEEP_ALL."""
    reliable = ReliabilityPolicy.RELIABLE
    if is_latched(topic):
        return QoSProfile(
            depth=max(1, topic.messages),
            reliability=reliable,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliable)
