"""Plays bags back onto the topics they came from."""

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
from fss_arm_bags.replay import choose, is_latched, profile
from fss_arm_bags.settings import ReplaySettings
from fss_arm_ros.convert import SECOND, seconds, to_time
from fss_arm_ros.diagnostics import OK, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.rclpy_compat import RCLError

TICK = 0.002  # [s]
STALL = 0.1  # longest step of bag time: after a pause the replay goes on, it does not catch up [s]
SILENCE = 10 * SECOND  # of bag time; a longer one is skipped, as that between two sessions [ns]
# At rate 0. Larger bursts overrun the transport's queue, and what is sent again comes late.
BURST = 50  # messages between two acknowledgements
ACK_TIMEOUT = 0.05  # an acknowledgement comes with a heartbeat, which may be slow [s]
CLOCK_STEP = SECOND // 100  # [ns]
RIVALS = 0.25  # from one check for other publishers to the next [s]


class ReplayNode(Node):
    """Plays bags, or folders of bags, back as one, in order of receipt.

    Nothing is lost on the way: volatile topics are published reliably and keep all, so that a
    slow subscriber that keeps all slows the replay. Long silences are skipped. Latched topics are
    latched; after a start within the bags they say first what they said last. Measurements are
    played in place, what was computed under recorded/, commands never. A topic with another
    publisher ends the replay.
    """

    def __init__(self, *bags: str, **options: Any) -> None:
        super().__init__("replay", **options)
        self.settings = declare(self, ReplaySettings)
        self.bags = open_bags(bags)
        for damage in [*self.bags.recovered, *self.bags.left_out]:
            self.get_logger().warning(str(damage))
        self.begin, self.end = self.bags.span
        self.begin += round(self.settings.start * SECOND)
        if self.begin > self.end:
            length = seconds(self.end - self.bags.span[0])
            raise ValueError(f"start is {self.settings.start} s, but the bags last {length:.3f} s")
        self.upgraded: dict[str, Any] = {}  # recorded topics of an earlier type: the present one
        self.players = self.make_players()
        self.clock = self.create_publisher(Clock, "/clock", 1) if self.settings.clock else None
        self.played = 0
        self.state = "waiting for subscribers"
        self.turn = monotonic()  # when the last tick was
        self.bag_time = self.clock_time = 0  # [ns]
        self.steps = self.play()
        steady = NodeClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TICK, lambda: next(self.steps, None), clock=steady)
        self.create_timer(RIVALS, self.end_beside_rivals, clock=steady)
        Diagnostics(self, self.health)

    def make_players(self) -> dict[str, Publisher]:
        """A publisher for each recorded topic that is played back, by recorded name."""
        players = {}
        for topic, name in choose(self.bags.topics, self.settings.topics).items():
            about = self.bags.topics[topic]
            try:
                if about.mixed:
                    raise BagError(f"the bags {two_versions(about.msgtype)}")
                kind = message_class(about.msgtype)
                if about.hash not in ("", definition(about.msgtype).hash):
                    if not extends(about.msgtype, about.definition):
                        raise NotInstalledError(f"{about.msgtype} is installed in another version")
                    self.upgraded[topic] = kind
            except (BagError, NotInstalledError) as error:
                self.get_logger().warning(f"{topic} is not played: {error}")
                continue
            players[topic] = self.create_publisher(kind, name, profile(about))
        left = ", ".join(sorted(set(self.bags.topics) - set(players))) or "nothing"
        self.get_logger().info(f"playing {', '.join(players) or 'nothing'}; leaving out {left}")
        return players

    def play(self) -> Iterator[None]:
        """The whole replay; yields whenever it has to wait for a tick."""
        yield from self.wait_for_subscribers()
        try:
            yield from self.play_once()
            while self.settings.loop:
                self.get_logger().info("begins again")
                yield from self.play_once()
        except BagError as error:
            raise SystemExit(str(error)) from None
        self.state = "waiting until all is acknowledged"
        yield from self.wait_for_acknowledgement()
        self.state = "holding" if self.settings.hold else "done"
        self.get_logger().info(f"played {self.played} messages; {self.state}")
        if not self.settings.hold:
            raise SystemExit(0)

    def play_once(self) -> Iterator[None]:
        """From the start to the end."""
        self.bag_time, tenth = 0, 0
        for topic, msgtype, data in self.latched_before():
            yield from self.send(topic, msgtype, data)
        for topic, msgtype, receipt, data in self.bags.raw(self.players, self.begin):
            yield from self.pace(receipt)
            yield from self.send(topic, msgtype, data)
            if self.settings.rate == 0.0 and self.played % BURST == 0:
                yield from self.wait_for_acknowledgement(ACK_TIMEOUT)
            if (now := 10 * (receipt - self.begin) // max(1, self.end - self.begin)) > tenth:
                tenth = now
                self.get_logger().info(f"{10 * tenth} %")

    def latched_before(self) -> Iterable[tuple[str, str, bytes]]:
        """What latched topics said last before the start."""
        latched = [topic for topic in self.players if is_latched(self.bags.topics[topic])]
        last: dict[str, tuple[str, str, bytes]] = {}
        for topic, msgtype, _, data in self.bags.raw(latched, stop=self.begin):
            last[topic] = topic, msgtype, data
        return last.values()

    def send(self, topic: str, msgtype: str, data: bytes) -> Iterator[None]:
        """Publish, as soon as all subscribers have room."""
        message: Any = data
        if topic in self.upgraded:
            message = upgrade(self.bags.deserialize(data, msgtype), self.upgraded[topic])
        while not self.publish(self.players[topic], message):
            yield
        self.played += 1

    def end_beside_rivals(self) -> None:
        """End if somebody else publishes what is played."""
        for player in [*self.players.values(), *([self.clock] if self.clock else [])]:
            if self.count_publishers(player.topic_name) > 1:
                others = {p.node_name for p in self.get_publishers_info_by_topic(player.topic_name)}
                names = ", ".join(sorted(others - {self.get_name()})) or "another replay"
                raise SystemExit(
                    f"{player.topic_name} is published by {names}: stop that, or choose topics"
                )

    def wait_for_subscribers(self) -> Iterator[None]:
        """Until the topics of wait_for are subscribed to, or anybody had the time to subscribe."""
        begin = monotonic()
        wanted = Counter(map(self.resolve_topic_name, self.settings.wait_for))
        names = {player.topic_name: player for player in self.players.values()}
        if unknown := set(wanted) - set(names):
            raise SystemExit(f"wait_for: {', '.join(unknown)} is not played")
        missing = [*wanted]
        while missing or not wanted:
            waited = monotonic() - begin
            if not wanted and waited >= self.settings.discovery:
                break
            if missing and waited >= self.settings.deadline:
                raise SystemExit(f"too few subscribers of {', '.join(missing)} in {waited:.0f} s")
            missing = [n for n, few in wanted.items() if names[n].get_subscription_count() < few]
            yield
        self.state = "playing"

    def pace(self, receipt: int) -> Iterator[None]:
        """Until it is time for a message, but not through a silence; publish the time on /clock."""
        rate = self.settings.rate
        silence = receipt - self.bag_time if self.bag_time and rate else 0
        if silence > SILENCE:
            self.get_logger().info(f"skips {seconds(silence):.0f} s of silence")
        if rate == 0.0 or self.bag_time == 0 or silence > SILENCE:
            self.bag_time, self.turn = receipt, monotonic()
        while self.bag_time < receipt:
            self.publish_clock(self.bag_time)
            yield
            now = monotonic()
            self.bag_time += int(rate * min(now - self.turn, STALL) * SECOND)
            self.turn = now
        self.publish_clock(receipt)

    def wait_for_acknowledgement(self, timeout: float = inf) -> Iterator[None]:
        """Until all subscribers have everything, for `timeout` [s] at most."""
        begin = monotonic()
        yield  # at least once: a burst may be acknowledged at once, and others want their turn
        while not all(p.wait_for_all_acked(Duration()) for p in self.players.values()):
            if monotonic() - begin > timeout:
                return
            yield

    def publish(self, player: Publisher, message: Any) -> bool:
        """Publish; False if a subscriber has no room for more, which is to be tried again."""
        try:
            player.publish(message)
        except RCLError:
            if not self.context.ok():
                raise
            return False
        return True

    def publish_clock(self, ns: int) -> None:
        """Publish /clock if it is asked for and due."""
        if self.clock and not 0 <= ns - self.clock_time < CLOCK_STEP:
            self.clock.publish(Clock(clock=to_time(ns)))
            self.clock_time = ns

    def health(self) -> Health:
        """What it is doing, and how far it is."""
        at = max(0.0, seconds(self.bag_time - self.begin))
        values = {"played": self.played, "at [s]": at, "of [s]": seconds(self.end - self.begin)}
        return Health(OK, self.state, values)

    def unfinished(self) -> str:
        """What is left to play, if that comes to an end."""
        if self.settings.loop or self.state in ("holding", "done"):
            return ""
        played, length = self.bag_time - self.begin, self.end - self.begin
        return f"after {max(0.0, seconds(played)):.1f} of {seconds(length):.1f} s"

    def close(self) -> None:
        """Leave the bags."""
        self.bags.close()


if __name__ == "__main__":
    sys.exit(main())
