"""Node that plays bags back onto their topics."""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from math import inf
from time import monotonic
from typing import Any

from rclpy.clock import Clock as NodeClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from fss_arm_bags.definitions import NotInstalledError, definition, extends, message_class, upgrade
from fss_arm_bags.programs import replay as main
from fss_arm_bags.reader import BagError, open_bags, two_versions
from fss_arm_bags.replay import choose_topics, is_latched, playback_qos
from fss_arm_bags.settings import ReplaySettings
from fss_arm_ros.convert import SECOND, seconds, to_time
from fss_arm_ros.diagnostics import OK, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.rclpy_compat import RCLError

TICK = 0.002  # [s]
MAX_STEP = 0.1  # of bag time: the replay does not catch up after a pause [s]
MAX_SILENCE = 10 * SECOND  # of bag time; a longer silence is skipped [ns]
# For rate 0: larger bursts overrun the transport's queue, and messages sent again are late.
BURST_SIZE = 50  # messages between two acknowledgements
ACK_TIMEOUT = 0.05  # an acknowledgement comes with a heartbeat, which may be slow [s]
CLOCK_STEP = SECOND // 100  # [ns]
PUBLISHER_CHECK_PERIOD = 0.25  # [s]


class ReplayNode(Node):
    """Node that plays bags, or folders of bags, back as one, in order of receipt.

    No message is lost: volatile topics are published reliably with KEEP_ALL, so a slow
    subscriber with KEEP_ALL slows the replay. Long silences are skipped. Latched topics are
    latched; after a start within the bags, their last message before the start is published
    first. Measurements are played in place, computed results under recorded/, and commands
    never. If a topic has another publisher, the replay stops.
    """

    def __init__(self, *bags: str, **options: Any) -> None:
        super().__init__("replay", **options)
        self.settings = declare(self, ReplaySettings)
        self.bags = open_bags(bags)
        for damage in [*self.bags.recovered, *self.bags.left_out]:
            self.get_logger().warning(str(damage))
        self.start, self.end = self.bags.span
        self.start += round(self.settings.start * SECOND)
        if self.start > self.end:
            length = seconds(self.end - self.bags.span[0])
            raise ValueError(
                f"start is {self.settings.start} s, but the bags last only {length:.3f} s"
            )
        self.upgraded_types: dict[str, Any] = {}  # current classes of topics with an earlier type
        self.players = self.create_players()
        self.clock = self.create_publisher(Clock, "/clock", 1) if self.settings.clock else None
        self.played = 0
        self.state = "waiting for subscribers"
        self.tick_time = monotonic()  # time of the last tick
        self.bag_time = self.clock_time = 0  # [ns]
        self.steps = self.play()
        steady = NodeClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TICK, lambda: next(self.steps, None), clock=steady)
        self.create_timer(PUBLISHER_CHECK_PERIOD, self.stop_on_duplicate_publisher, clock=steady)
        Diagnostics(self, self.health)

    def create_players(self) -> dict[str, Publisher]:
        """Create a publisher for each recorded topic that is played back, by recorded name."""
        players = {}
        for topic, name in choose_topics(self.bags.topics, self.settings.topics).items():
            about = self.bags.topics[topic]
            try:
                if about.mixed:
                    raise BagError(f"the bags {two_versions(about.msgtype)}")
                kind = message_class(about.msgtype)
                if about.hash not in ("", definition(about.msgtype).hash):
                    if not extends(about.msgtype, about.definition):
                        raise NotInstalledError(f"{about.msgtype} is installed in another version")
                    self.upgraded_types[topic] = kind
            except (BagError, NotInstalledError) as error:
                self.get_logger().warning(f"{topic} is not played: {error}")
                continue
            players[topic] = self.create_publisher(kind, name, playback_qos(about))
        skipped = ", ".join(sorted(set(self.bags.topics) - set(players))) or "nothing"
        self.get_logger().info(f"playing {', '.join(players) or 'nothing'}; leaving out {skipped}")
        return players

    def play(self) -> Iterator[None]:
        """Run the whole replay; yield whenever it must wait for a tick."""
        yield from self.wait_for_subscribers()
        try:
            yield from self.play_once()
            while self.settings.loop:
                self.get_logger().info("repeating from the start")
                yield from self.play_once()
        except BagError as error:
            raise SystemExit(str(error)) from None
        self.state = "waiting for acknowledgements"
        yield from self.wait_for_acknowledgement()
        self.state = "holding" if self.settings.hold else "done"
        self.get_logger().info(f"played {self.played} messages; {self.state}")
        if not self.settings.hold:
            raise SystemExit(0)

    def play_once(self) -> Iterator[None]:
        """Play the bags once, from the start to the end."""
        self.bag_time, tenth = 0, 0
        for topic, msgtype, data in self.latched_before_start():
            yield from self.send(topic, msgtype, data)
        for topic, msgtype, receipt, data in self.bags.raw(self.players, self.start):
            yield from self.pace(receipt)
            yield from self.send(topic, msgtype, data)
            if self.settings.rate == 0.0 and self.played % BURST_SIZE == 0:
                yield from self.wait_for_acknowledgement(ACK_TIMEOUT)
            if (now := 10 * (receipt - self.start) // max(1, self.end - self.start)) > tenth:
                tenth = now
                self.get_logger().info(f"{10 * tenth} %")

    def latched_before_start(self) -> Iterable[tuple[str, str, bytes]]:
        """Return the last message of each latched topic before the start."""
        latched = [topic for topic in self.players if is_latched(self.bags.topics[topic])]
        last: dict[str, tuple[str, str, bytes]] = {}
        for topic, msgtype, _, data in self.bags.raw(latched, stop=self.start):
            last[topic] = topic, msgtype, data
        return last.values()

    def send(self, topic: str, msgtype: str, data: bytes) -> Iterator[None]:
        """Publish a message as soon as all subscribers have room."""
        message: Any = data
        if topic in self.upgraded_types:
            message = upgrade(self.bags.deserialize(data, msgtype), self.upgraded_types[topic])
        while not self.publish(self.players[topic], message):
            yield
        self.played += 1

    def stop_on_duplicate_publisher(self) -> None:
        """Stop if another node publishes a topic that is played."""
        for player in [*self.players.values(), *([self.clock] if self.clock else [])]:
            if self.count_publishers(player.topic_name) > 1:
                others = {p.node_name for p in self.get_publishers_info_by_topic(player.topic_name)}
                names = ", ".join(sorted(others - {self.get_name()})) or "another replay"
                raise SystemExit(
                    f"{player.topic_name} is also published by {names}: "
                    "stop it, or choose other topics"
                )

    def wait_for_subscribers(self) -> Iterator[None]:
        """Wait until the topics of wait_for have subscribers, or for the discovery time."""
        start = monotonic()
        wanted = Counter(map(self.resolve_topic_name, self.settings.wait_for))
        names = {player.topic_name: player for player in self.players.values()}
        if unknown := set(wanted) - set(names):
            raise SystemExit(f"wait_for: {', '.join(unknown)} is not played")
        missing = [*wanted]
        while missing or not wanted:
            waited = monotonic() - start
            if not wanted and waited >= self.settings.discovery:
                break
            if missing and waited >= self.settings.deadline:
                raise SystemExit(
                    f"too few subscribers of {', '.join(missing)} after {waited:.0f} s"
                )
            missing = [
                n for n, count in wanted.items() if names[n].get_subscription_count() < count
            ]
            yield
        self.state = "playing"

    def pace(self, receipt: int) -> Iterator[None]:
        """Wait until a message is due, but skip long silences; publish the time on /clock."""
        rate = self.settings.rate
        silence = receipt - self.bag_time if self.bag_time and rate else 0
        if silence > MAX_SILENCE:
            self.get_logger().info(f"skipping {seconds(silence):.0f} s of silence")
        if rate == 0.0 or self.bag_time == 0 or silence > MAX_SILENCE:
            self.bag_time, self.tick_time = receipt, monotonic()
        while self.bag_time < receipt:
            self.publish_clock(self.bag_time)
            yield
            now = monotonic()
            self.bag_time += int(rate * min(now - self.tick_time, MAX_STEP) * SECOND)
            self.tick_time = now
        self.publish_clock(receipt)

    def wait_for_acknowledgement(self, timeout: float = inf) -> Iterator[None]:
        """Wait until subscribers acknowledge all messages, for at most `timeout` [s]."""
        start = monotonic()
        yield  # wait one tick at least, so that other callbacks can run
        while not all(p.wait_for_all_acked(Duration()) for p in self.players.values()):
            if monotonic() - start > timeout:
                return
            yield

    def publish(self, player: Publisher, message: Any) -> bool:
        """Publish; return False if a subscriber has no room, and the caller must try again."""
        try:
            player.publish(message)
        except RCLError:
            if not self.context.ok():
                raise
            return False
        return True

    def publish_clock(self, ns: int) -> None:
        """Publish /clock if it is enabled and due."""
        if self.clock and not 0 <= ns - self.clock_time < CLOCK_STEP:
            self.clock.publish(Clock(clock=to_time(ns)))
            self.clock_time = ns

    def health(self) -> Health:
        """Return the diagnostic status: state and progress."""
        at = max(0.0, seconds(self.bag_time - self.start))
        values = {"played": self.played, "at [s]": at, "of [s]": seconds(self.end - self.start)}
        return Health(OK, self.state, values)

    def unfinished(self) -> str:
        """Return the progress of an unfinished replay; empty: it is finished, or repeats."""
        if self.settings.loop or self.state in ("holding", "done"):
            return ""
        played, length = self.bag_time - self.start, self.end - self.start
        return f"after {max(0.0, seconds(played)):.1f} of {seconds(length):.1f} s"

    def close(self) -> None:
        """Close the bags."""
        self.bags.close()


if __name__ == "__main__":
    sys.exit(main())
