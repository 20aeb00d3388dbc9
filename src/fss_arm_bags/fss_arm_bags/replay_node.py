"""Node that plays bags back onto their topics."""

import sys
from collections import Counter
from time import monotonic
from typing import Any

from rclpy.clock import Clock as NodeClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from fss_arm_bags.definitions import message_class
from fss_arm_bags.playback import Playback, PlaybackError, playback_span
from fss_arm_bags.programs import replay as main
from fss_arm_bags.reader import BagError, open_bags
from fss_arm_bags.replay import (
    choose_topics,
    has_installed_version,
    playback_qos,
    type_problem,
)
from fss_arm_bags.settings import ReplaySettings
from fss_arm_ros.convert import to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.rclpy_compat import RCLError

TICK = 0.002  # period of the timer that publishes the messages that are due [s]
PUBLISHER_CHECK_PERIOD = 0.25  # of the search for other publishers [s]
MAX_WAIT_FOR_ROOM = 1.0  # a longer wait for a slow subscriber is reported [s]


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
        span = playback_span(self.bags.span, self.settings.start)
        self.upgraded_types: dict[str, Any] = {}  # current classes of topics with an earlier type
        self.players = self.create_players()
        self.players_by_name = {player.topic_name: player for player in self.players.values()}
        self.refused: tuple[str, float] | None = None  # topic without room, and since when [s]
        # A topic that wait_for names n times needs n subscribers.
        wait_for = Counter(map(self.resolve_topic_name, self.settings.wait_for))
        self.playback = Playback(
            self.bags, span, self.settings, self.players, self.upgraded_types, wait_for, self
        )
        self.clock = self.create_publisher(Clock, "/clock", 1) if self.settings.clock else None
        self.steps = self.playback.steps()
        steady = NodeClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TICK, self.tick, clock=steady)
        self.create_timer(PUBLISHER_CHECK_PERIOD, self.stop_on_duplicate_publisher, clock=steady)
        Diagnostics(self, self.health)

    def create_players(self) -> dict[str, Publisher]:
        """Create a publisher for each recorded topic that is played back, by recorded name."""
        players = {}
        for topic, name in choose_topics(self.bags.topics, self.settings.topics).items():
            about = self.bags.topics[topic]
            if problem := type_problem(about):
                self.get_logger().warning(f"{topic} is not played: {problem}")
                continue
            kind = message_class(about.msgtype)
            if not has_installed_version(about):
                self.upgraded_types[topic] = kind
            players[topic] = self.create_publisher(kind, name, playback_qos(about))
        names = {topic: player.topic_name for topic, player in players.items()}
        played = [a if a == b else f"{a} as {b}" for a, b in names.items()]
        skipped = ", ".join(sorted(set(self.bags.topics) - set(players))) or "nothing"
        self.get_logger().info(f"playing {', '.join(played) or 'nothing'}; leaving out {skipped}")
        return players

    def tick(self) -> None:
        """Play on; exit at the end, or with the reason why nothing more can be played."""
        try:
            next(self.steps, None)
        except (BagError, PlaybackError) as error:
            raise SystemExit(str(error)) from None
        if self.playback.state == "done":
            raise SystemExit(0)

    def stop_on_duplicate_publisher(self) -> None:
        """Stop if another node publishes a topic that is played."""
        for player in [*self.players.values(), *([self.clock] if self.clock else [])]:
            if self.count_publishers(player.topic_name) > 1:
                others = {p.node_name for p in self.get_publishers_info_by_topic(player.topic_name)}
                names = ", ".join(sorted(others - {self.get_name()})) or "another replay"
                advice = "set clock:=false" if player is self.clock else "choose other topics"
                raise SystemExit(
                    f"{player.topic_name} is also published by {names}: stop it, or {advice}"
                )

    def publish(self, topic: str, message: Any) -> bool:
        """Publish; return False if a subscriber has no room, and the caller must try again."""
        try:
            self.players[topic].publish(message)
        except RCLError:
            if not self.context.ok():
                raise
            self.refused = self.refused or (self.players[topic].topic_name, monotonic())
            return False
        self.refused = None
        return True

    def publish_clock(self, ns: int) -> None:
        """Publish a time on /clock."""
        if self.clock:
            self.clock.publish(Clock(clock=to_time(ns)))

    def is_acknowledged(self) -> bool:
        """Return True if subscribers have acknowledged all messages."""
        return all(player.wait_for_all_acked(Duration()) for player in self.players.values())

    def count_subscribers_of(self, name: str) -> int | None:
        """Return the number of subscribers of a name that is played; None: it is not played."""
        player = self.players_by_name.get(name)
        return player.get_subscription_count() if player else None

    def log(self, text: str) -> None:
        """Log a line."""
        self.get_logger().info(text)

    def health(self) -> Health:
        """Return the diagnostic status: state and progress."""
        at, length = self.playback.progress
        values = {"played": self.playback.played, "at [s]": at, "of [s]": length}
        if self.refused and (waited := monotonic() - self.refused[1]) > MAX_WAIT_FOR_ROOM:
            words = f"waiting {waited:.1f} s for a subscriber of {self.refused[0]}"
            return Health(WARN, words, values)
        return Health(OK, self.playback.state, values)

    def unfinished(self) -> str:
        """Return the progress of an unfinished replay; empty: it is finished, or repeats."""
        if self.settings.loop or self.playback.state in ("holding", "done"):
            return ""
        at, length = self.playback.progress
        return f"after {at:.1f} of {length:.1f} s"

    def close(self) -> None:
        """Close the bags."""
        self.bags.close()


if __name__ == "__main__":
    sys.exit(main())
