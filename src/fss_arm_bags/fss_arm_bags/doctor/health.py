"""Check whether a bag is fit for calibration: gaps, clocks, types and QoS, topic by topic."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from rosbags.interfaces import QosReliability

from fss_arm_bags.definitions import (
    MEASUREMENTS,
    ROSBAG2_TYPES,
    NotInstalledError,
    definition,
    extends,
)
from fss_arm_bags.reader import BagError, Bags, Topic, two_versions
from fss_arm_ros.convert import SECOND

GAP_PERIODS = 5  # a longer silence of a steady topic, in its periods, is a gap
MIN_GAP = 3 * SECOND // 10  # [ns]; a single link publishes every 0.2 s
MIN_CLOCK_JUMP = SECOND // 2  # smallest step of stamps against times of receipt [ns]
DELAY_WINDOW = 2 * SECOND  # in this time at least one message arrives without delay [ns]
MIN_CLOCK_OFFSET = 2 * SECOND  # of stamps from times of receipt: two different clocks [ns]

STAMP = struct.Struct(
    "<4xiI"
)  # stamp of a message that starts with a header, little-endian as DDS writes it


@dataclass(frozen=True)
class Stream:
    """Times of receipt and stamps of the messages of a topic."""

    receipts: np.ndarray  # [ns]
    stamps: np.ndarray  # [ns]; empty: the type has no stamp
    bag_starts: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  # [ns]

    @property
    def same_bag(self) -> np.ndarray:
        """Mask of the messages but the last: True if the next one is in the same bag."""
        return np.diff(np.searchsorted(self.bag_starts, self.receipts, side="right")) == 0

    @property
    def rate(self) -> float:
        """Message rate [Hz]; NaN: fewer than two messages."""
        received = np.diff(self.receipts)[self.same_bag]
        return float(len(received) * SECOND / total) if (total := received.sum()) else np.nan

    @property
    def intervals(self) -> np.ndarray:
        """Intervals between successive messages [ns].

        The smaller of two intervals counts, by receipt and by stamp. A recorder that was delayed
        received late, but lost nothing; a clock that jumped forward did not make a pause. The
        interval from one bag to the next is 0 because nothing was recorded.
        """
        received = np.diff(self.receipts) * self.same_bag
        return np.minimum(received, np.diff(self.stamps)) if len(self.stamps) else received

    @property
    def longest_gap(self) -> float:
        """The longest silence [s]; NaN: fewer than two messages."""
        return float(self.intervals.max() / SECOND) if len(self.receipts) > 1 else np.nan


def streams(bags: Bags) -> dict[str, Stream]:
    """Return the times of all messages, by topic.

    Raises:
        BagError: a bag is damaged.
    """
    topics = bags.topics  # which is rebuilt whenever it is read
    receipts: dict[str, list[int]] = {topic: [] for topic in topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in topics}
    for topic, msgtype, receipt, data in bags.raw():
        receipts[topic].append(receipt)
        if bags.unchecked and not topics[topic].mixed:
            bags.deserialize(data, msgtype)  # raises BagError if the data do not fit the type
        if msgtype in MEASUREMENTS:
            try:
                sec, nanosec = STAMP.unpack_from(data)
            except struct.error:
                raise BagError(
                    f"{topic}: a message of {len(data)} bytes is not a {msgtype}"
                ) from None
            stamps[topic].append(sec * SECOND + nanosec)
    bag_starts = np.array(bags.starts, np.int64)
    return {
        topic: Stream(
            np.array(receipts[topic], np.int64), np.array(stamps[topic], np.int64), bag_starts
        )
        for topic in receipts
    }


def remark(topic: Topic) -> str:
    """Return a note on a topic that has no problem; empty: there is none."""
    try:
        installed_hash = definition(topic.msgtype).hash
    except NotInstalledError:
        return ""
    if (
        topic.mixed
        or topic.hash in ("", installed_hash)
        or not extends(topic.msgtype, topic.definition)
    ):
        return ""
    return "earlier version of the type; replay gives the missing fields their defaults"


def findings(topic: Topic, stream: Stream, start: int) -> Iterator[str]:
    """Yield the problems of a topic, one sentence each; times count from `start` [ns]."""
    yield from _type_problems(topic)
    if topic.msgtype not in MEASUREMENTS:
        return
    if not len(stream.receipts):
        yield "has no messages"
        return
    if any(qos.reliability == QosReliability.BEST_EFFORT for qos in topic.qos):
        yield "was published best effort: messages may have been lost"
    yield from _gap_problems(stream, start)
    yield from _clock_problems(stream, start)


def _type_problems(topic: Topic) -> Iterator[str]:
    """Yield a problem if messages of this type cannot be read as the installed version."""
    try:
        installed_hash = definition(topic.msgtype).hash
    except NotInstalledError as error:
        if not topic.msgtype.startswith(ROSBAG2_TYPES):
            yield f"{error}; replay skips it"
        return
    if topic.mixed:
        yield f"the bags {two_versions(topic.msgtype)}"
    elif topic.hash not in ("", installed_hash) and not extends(topic.msgtype, topic.definition):
        yield f"{topic.msgtype} is installed in another version; replay skips it"


def _gap_problems(stream: Stream, start: int) -> Iterator[str]:
    """Yield a problem if silences are long for a steady topic."""
    intervals = stream.intervals
    if not len(intervals):
        return
    gaps = np.flatnonzero(intervals > max(GAP_PERIODS * np.median(intervals), MIN_GAP))
    if len(gaps):
        worst = gaps[np.argmax(intervals[gaps])]
        yield (
            f"{_count(len(gaps), 'gap')}; the longest lasts {intervals[worst] / SECOND:.3f} s "
            f"at {(stream.receipts[worst] - start) / SECOND:.3f} s"
        )


def _clock_problems(stream: Stream, start: int) -> Iterator[str]:
    """Yield problems of the stamps: jumps against the times of receipt, or another clock."""
    delays = stream.receipts - stream.stamps
    # Least delay in each window: a delayed message carries no information about its clock.
    starts = np.flatnonzero(
        np.diff((stream.receipts - stream.receipts[0]) // DELAY_WINDOW, prepend=-1)
    )
    steps = np.diff(np.minimum.reduceat(delays, starts))
    jumps = np.flatnonzero(np.abs(steps) > MIN_CLOCK_JUMP)
    if len(jumps):
        around = slice(starts[jumps[0]], np.append(starts, len(delays))[jumps[0] + 2])
        place = around.start + np.argmax(np.abs(np.diff(delays[around]))) + 1
        yield (
            f"{_count(len(jumps), 'jump')} of its stamps against the times of receipt, the first "
            f"by {-steps[jumps[0]] / SECOND:+.3f} s "
            f"at {(stream.receipts[place] - start) / SECOND:.3f} s"
        )
    delay = float(np.median(delays)) / SECOND
    if abs(delay) * SECOND > MIN_CLOCK_OFFSET:
        yield (
            f"its stamps are {abs(delay):.3f} s {'before' if delay > 0 else 'after'} the times of "
            "receipt: synchronize the clocks, unless the publisher lags"
        )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
