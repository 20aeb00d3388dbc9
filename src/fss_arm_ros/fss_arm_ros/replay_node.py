"""Plays bags back onto the topics they came from."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from time import monotonic
from typing import Any

from rclpy.clock import Clock as NodeClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability
from rosgraph_msgs.msg import Clock

from .bags import BagError, Topic, open_bags
from .convert import SECOND, to_time
from .definitions import NotInstalledError, definition, message_class
from .diagnostics import OK, Diagnostics, Health
from .run import RCLError, run
from .settings import declare, setting

TICK = 0.002  # [s]
STALL = 0.1  # longest step of bag time: after a pause the replay goes on, it does not catch up [s]
# At rate 0. Larger bursts overrun the transport's queue, and what is sent again comes late.
BURST = 50  # messages between two acknowledgements
PATIENCE = 0.05  # with an acknowledgement; it comes with a heartbeat, which may be slow [s]
CLOCK_STEP = SECOND // 100  # [ns]


@dataclass(frozen=True)
class ReplaySettings:
    """The parameters of a ReplayNode."""

    rate: float = setting(1.0, "multiple of the recorded pace; 0: as fast as subscribers take it")
    clock: bool = setting(False, "publish /clock from the times of receipt")
    hold: bool = setting(False, "stay up after the end, so that latched topics stay, too")
    wait_for: tuple[str, ...] = setting((), "topics that must have a subscriber before the start")
    deadline: float = setting(20.0, "how long to wait for them [s]")
    discovery: float = setting(3.0, "time for subscribers to show up if wait_for is empty [s]")

    def __post_init__(self) -> None:
        for name in ("rate", "deadline", "discovery"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}, must not be negative")


def played_as(topic: str) -> str | None:
    """The topic that a recorded one is played back on; None: it is not.

    What makes something move, and what ROS itself publishes, is never played. Verdicts go
    under recorded/: they must not be taken for those of the nodes that run now.
    """
    parts = topic.strip("/").split("/")
    if parts[-1] == "command" or {"arm", "thrusters"} & set(parts):
        return None
    if topic in ("/clock", "/rosout", "/parameter_events"):
        return None
    if "calibration" in parts or topic == "/diagnostics":
        return f"recorded{topic}"
    return topic


class ReplayNode(Node):
    """Plays bags, or folders of bags, back as one, in order of receipt.

    Nothing is lost on the way: volatile topics are published reliably and keep all, so that a
    slow subscriber that keeps all slows the replay. Latched topics are latched. Commands are
    never played back; calibration/* and diagnostics come under recorded/.
    """

    def __init__(self, *bags: str, **options: Any) -> None:
        super().__init__("replay", **options)
        self.settings = declare(self, ReplaySettings)
        self.bags = open_bags(bags)
        for damage in self.bags.recovered:
            self.get_logger().warning(str(damage))
        self.players = self.make_players()
        self.clock = self.create_publisher(Clock, "/clock", 1) if self.settings.clock else None
        self.total = sum(self.bags.topics[topic].messages for topic in self.players)
        self.played = 0
        self.state = "waiting for subscribers"
        self.turn = monotonic()  # when the last tick was
        self.bag_time = self.told = 0  # [ns]
        self.steps = self.play()
        steady = NodeClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TICK, lambda: next(self.steps, None), clock=steady)
        Diagnostics(self, self.health)

    def make_players(self) -> dict[str, Publisher]:
        """A publisher for each recorded topic that is played back, by recorded name."""
        players = {}
        for topic, about in self.bags.topics.items():
            if (name := played_as(topic)) is None:
                continue
            try:
                if about.hash not in ("", definition(about.msgtype).hash):
                    raise NotInstalledError(f"{about.msgtype} is installed in another version")
                kind = message_class(about.msgtype)
            except NotInstalledError as error:
                self.get_logger().warning(f"{topic} is not played: {error}")
                continue
            players[topic] = self.create_publisher(kind, name, profile(about))
        left = ", ".join(set(self.bags.topics) - set(players)) or "nothing"
        self.get_logger().info(f"playing {', '.join(players) or 'nothing'}; leaving out {left}")
        return players

    def play(self) -> Iterator[None]:
        """The whole replay; yields whenever it has to wait for a tick."""
        yield from self.wait_for_subscribers()
        try:
            for count, (topic, _, receipt, data) in enumerate(self.bags.raw(self.players), 1):
                yield from self.pace(receipt)
                while not self.publish(self.players[topic], data):
                    yield
                self.played = count
                if count * 10 // self.total > (count - 1) * 10 // self.total:
                    self.get_logger().info(f"{count} of {self.total} messages")
                if self.settings.rate == 0.0 and count % BURST == 0:
                    yield from self.wait_for_acknowledgement(PATIENCE)
        except BagError as error:
            raise SystemExit(str(error)) from None
        self.state = "waiting until all is acknowledged"
        yield from self.wait_for_acknowledgement()
        self.state = "holding" if self.settings.hold else "done"
        self.get_logger().info(f"played {self.played} messages; {self.state}")
        if not self.settings.hold:
            raise SystemExit(0)

    def wait_for_subscribers(self) -> Iterator[None]:
        """Until the topics of wait_for are subscribed to, or anybody had the time to subscribe."""
        begin, missing = monotonic(), [self.resolve_topic_name(t) for t in self.settings.wait_for]
        names = {player.topic_name: player for player in self.players.values()}
        if unknown := set(missing) - set(names):
            raise SystemExit(f"wait_for: {', '.join(unknown)} is not played")
        while missing or not self.settings.wait_for:
            waited = monotonic() - begin
            if not missing and waited >= self.settings.discovery:
                break
            if missing and waited >= self.settings.deadline:
                raise SystemExit(f"no subscriber of {', '.join(missing)} within {waited:.0f} s")
            missing = [name for name in missing if not names[name].get_subscription_count()]
            yield
        self.state = "playing"

    def pace(self, receipt: int) -> Iterator[None]:
        """Until it is time for a message; tell the time on /clock."""
        rate = self.settings.rate
        if rate == 0.0 or self.bag_time == 0:
            self.bag_time, self.turn = receipt, monotonic()
        while self.bag_time < receipt:
            self.tell(self.bag_time)
            yield
            now = monotonic()
            self.bag_time += int(rate * min(now - self.turn, STALL) * SECOND)
            self.turn = now
        self.tell(receipt)

    def wait_for_acknowledgement(self, patience: float = inf) -> Iterator[None]:
        """Until all subscribers have everything, or patience [s] is at its end."""
        begin = monotonic()
        yield  # at least once: a burst may be acknowledged at once, and others want their turn
        while not all(p.wait_for_all_acked(Duration()) for p in self.players.values()):
            if monotonic() - begin > patience:
                return
            yield

    def publish(self, player: Publisher, data: bytes) -> bool:
        """Publish; False if a subscriber has no room for more, which is to be tried again."""
        try:
            player.publish(data)
        except RCLError:
            if not self.context.ok():
                raise
            return False
        return True

    def tell(self, ns: int) -> None:
        """Publish /clock if it is asked for and due."""
        if self.clock and not 0 <= ns - self.told < CLOCK_STEP:
            self.clock.publish(Clock(clock=to_time(ns)))
            self.told = ns

    def health(self) -> Health:
        """What it is doing, and how far it is."""
        return Health(OK, self.state, {"played": self.played, "messages": self.total})

    def close(self) -> None:
        """Leave the bags."""
        self.bags.close()


def profile(topic: Topic) -> QoSProfile:
    """How a topic is played back: latched with room for all of it, else keeping all."""
    reliable = ReliabilityPolicy.RELIABLE
    if any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in topic.qos):
        return QoSProfile(
            depth=max(1, topic.messages),
            reliability=reliable,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=reliable)


def main() -> int:
    """Entry point; `--hold` is short for the parameter."""
    args = [arg for arg in sys.argv if arg != "--hold"]
    if len(args) < len(sys.argv):
        args += ["--ros-args", "-p", "hold:=true"]
    return run(ReplayNode, ReplaySettings, args, takes="BAG... [--hold]")
