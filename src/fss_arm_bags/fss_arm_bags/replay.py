"""What of a bag is played back, under which name, and how."""

from collections.abc import Collection, Mapping

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability

from fss_arm_bags.definitions import MEASUREMENTS, RECORDERS
from fss_arm_bags.reader import Topic

ORDERS = ("command", "wrench", "trajectory", "stop")  # last words of topics that move something
TOLD = "pulses", "health"  # of the thrusters, which move nothing
IN_PLACE = ("/robot_description", "/thrusters/pulses")  # beside measurements
OF_ROS = ("/clock", "/rosout", "/parameter_events")


def choose(recorded: Mapping[str, Topic], wanted: Collection[str] = ()) -> dict[str, str]:
    """The topics to play, each with the name to play it under.

    Args:
        recorded: the topics of the bags.
        wanted: names of those to play in place; all that may be, as `played_as` says, by default.

    Raises:
        ValueError: a topic is wanted that moves something or is not in the bags.
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
    """Whether a topic makes something move; such are never played."""
    parts = topic.strip("/").split("/")
    thrusts = "thrusters" in parts and parts[-1] not in TOLD
    return parts[-1] in ORDERS or "arm" in parts or thrusts


def played_as(topic: str, msgtype: str) -> str | None:
    """The topic that a recorded one is played back on by default; None: it is not.

    What was computed goes under recorded/: it must not be taken for the results of the nodes
    that run now. What ROS and recorders publish of themselves is not played.
    """
    if is_command(topic) or topic in OF_ROS or msgtype.startswith(RECORDERS):
        return None
    if msgtype in MEASUREMENTS or topic.endswith(IN_PLACE):
        return topic
    return f"recorded{topic}"


def is_latched(topic: Topic) -> bool:
    """Whether a topic was published for those who come late, too."""
    return any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in topic.qos)


def profile(topic: Topic) -> QoSProfile:
    """How a topic is played back: latched with room for all of it, else keeping all."""
    reliable = ReliabilityPolicy.RELIABLE
    if is_latched(topic):
        return QoSProfile(
            depth=max(1, topic.messages),
            reliability=reliable,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliable)
