"""Playback of bags: which message is published when; the node provides the outputs."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from math import inf
from time import monotonic
from typing import Any, Protocol

from fss_arm_bags.definitions import upgrade
from fss_arm_bags.reader import Bags
from fss_arm_bags.replay import is_latched
from fss_arm_bags.settings import ReplaySettings
from fss_arm_ros.convert import SECOND, seconds

MAX_STEP = 0.1  # of bag time: the playback does not catch up after a pause [s]
MAX_SILENCE = 10 * SECOND  # of bag time; a longer silence is skipped [ns]
# For rate 0: larger bursts overrun the transport's queue, and messages sent again are late.
BURST_SIZE = 50  # messages between two acknowledgements
ACK_TIMEOUT = 0.05  # an acknowledgement comes with a heartbeat, which may be slow [s]
CLOCK_STEP = SECOND // 100  # [ns]


class PlaybackError(RuntimeError):
    """Exception for subscribers of wait_for that are missing."""


class Outputs(Protocol):
    """Interface of the node that a playback uses; topics have their recorded names."""

    def stop_on_duplicate_publisher(self) -> None:
        """Stop, by an exception, if another node publishes a topic that is played."""

    def publish(self, topic: str, message: Any) -> bool:
        """Publish; return False if a subscriber has no room, and the caller must try again."""

    def publish_clock(self, ns: int) -> None:
        """Publish a time on /clock."""

    def is_acknowledged(self) -> bool:
        """Return True if subscribers have acknowledged all messages."""

    def count_subscribers_of(self, name: str) -> int | None:
        """Return the number of subscribers of a name that is played; None: it is not played."""

    def log(self, text: str) -> None:
        """Log a line."""


def playback_span(span: tuple[int, int], start: float) -> tuple[int, int]:
    """Return start and end [ns] of a playback that starts `start` [s] after the first message.

    Raises:
        ValueError: the start is after the last message.
    """
    first, end = span
    if (since := first + round(start * SECOND)) > end:
        length = seconds(end - first)
        raise ValueError(f"start is {start} s, but the bags last only {length:.3f} s")
    return since, end


class Playback:
    """Playback of bags as one, in order of receipt. `steps` runs it, a step at each tick.

    Args:
        bags: the bags.
        span: start and end [ns], from `playback_span`.
        settings: rate, repetition and timeouts.
        topics: recorded names of the topics to play.
        upgraded_types: present classes of topics with an earlier type.
        wait_for: number of subscribers needed before the start, by name as played.
        outputs: the node.
        now: monotonic clock [s].
    """

    def __init__(
        self,
        bags: Bags,
        span: tuple[int, int],
        settings: ReplaySettings,
        topics: Collection[str],
        upgraded_types: Mapping[str, Any],
        wait_for: Mapping[str, int],
        outputs: Outputs,
        now: Callable[[], float] = monotonic,
    ) -> None:
        self.bags, self.settings, self.topics = bags, settings, topics
        self.start, self.end = span
        self.upgraded_types, self.wait_for, self.outputs = upgraded_types, wait_for, outputs
        self.now, self.played, self.state = now, 0, "waiting for subscribers"
        self.time = self._clock_time = 0  # bag time, and that on /clock [ns]
        self._tick = now()

    @property
    def progress(self) -> tuple[float, float]:
        """Time played, and length of the playback [s]."""
        return max(0.0, seconds(self.time - self.start)), seconds(self.end - self.start)

    def steps(self) -> Iterator[None]:
        """Run the whole playback; yield whenever it must wait for a tick.

        Raises:
            BagError: a bag is damaged.
            PlaybackError: subscribers are missing.
        """
        yield from self._wait_for_subscribers()
        self.outputs.stop_on_duplicate_publisher()
        self.state = "playing"
        yield from self._play_once()
        while self.settings.loop:
            yield  # a pass without a wait would otherwise repeat in the same tick
            self.outputs.log("repeating from the start")
            yield from self._play_once()
        self.state = "waiting for acknowledgements"
        yield from self._wait_for_acknowledgement()
        self.state = "holding" if self.settings.hold else "done"
        self.outputs.log(f"played {self.played} messages; {self.state}")

    def _wait_for_subscribers(self) -> Iterator[None]:
        """Wait until the topics of wait_for have subscribers, or for the discovery time."""
        start, count = self.now(), self.outputs.count_subscribers_of
        if unknown := [name for name in self.wait_for if count(name) is None]:
            raise PlaybackError(f"wait_for: {', '.join(unknown)} is not played")
        missing = [*self.wait_for]
        while missing or not self.wait_for:
            waited = self.now() - start
            if not self.wait_for and waited >= self.settings.discovery:
                break
            if missing and waited >= self.settings.deadline:
                names = ", ".join(missing)
                raise PlaybackError(f"too few subscribers of {names} after {waited:.0f} s")
            missing = [name for name, least in self.wait_for.items() if (count(name) or 0) < least]
            yield

    def _play_once(self) -> Iterator[None]:
        """Play the bags once, from the start to the end."""
        self.time, tenth = 0, 0
        for topic, msgtype, data in self._latched_before_start():
            yield from self._send(topic, msgtype, data)
        for topic, msgtype, receipt, data in self.bags.raw(self.topics, self.start):
            yield from self._pace(receipt)
            yield from self._send(topic, msgtype, data)
            if self.settings.rate == 0.0 and self.played % BURST_SIZE == 0:
                yield from self._wait_for_acknowledgement(ACK_TIMEOUT)
            if (now := 10 * (receipt - self.start) // max(1, self.end - self.start)) > tenth:
                tenth = now
                self.outputs.log(f"{10 * tenth} %")

    def _latched_before_start(self) -> Iterable[tuple[str, str, bytes]]:
        """Return the last message of each latched topic before the start."""
        latched = [topic for topic in self.topics if is_latched(self.bags.topics[topic])]
        last: dict[str, tuple[str, str, bytes]] = {}
        for topic, msgtype, _, data in self.bags.raw(latched, stop=self.start):
            last[topic] = topic, msgtype, data
        return last.values()

    def _send(self, topic: str, msgtype: str, data: bytes) -> Iterator[None]:
        """Publish a message as soon as all subscribers have room."""
        message: Any = data
        if topic in self.upgraded_types:
            message = upgrade(self.bags.deserialize(data, msgtype), self.upgraded_types[topic])
        while not self.outputs.publish(topic, message):
            yield
        self.played += 1

    def _pace(self, receipt: int) -> Iterator[None]:
        """Wait until a message is due, but skip long silences; publish the time on /clock."""
        rate = self.settings.rate
        silence = receipt - self.time if self.time and rate else 0
        if silence > MAX_SILENCE:
            self.outputs.log(f"skipping {seconds(silence):.0f} s of silence")
        if rate == 0.0 or self.time == 0 or silence > MAX_SILENCE:
            self.time, self._tick = receipt, self.now()
        while self.time < receipt:
            self._publish_clock(self.time)
            yield
            now = self.now()
            self.time += int(rate * min(now - self._tick, MAX_STEP) * SECOND)
            self._tick = now
        self._publish_clock(receipt)

    def _publish_clock(self, ns: int) -> None:
        """Publish /clock if it is enabled and due."""
        if self.settings.clock and not 0 <= ns - self._clock_time < CLOCK_STEP:
            self.outputs.publish_clock(ns)
            self._clock_time = ns

    def _wait_for_acknowledgement(self, timeout: float = inf) -> Iterator[None]:
        """Wait until subscribers acknowledge all messages, for at most `timeout` [s]."""
        start = self.now()
        yield  # wait one tick at least, so that other callbacks can run
        while not self.outputs.is_acknowledged():
            if self.now() - start > timeout:
                return
            yield
