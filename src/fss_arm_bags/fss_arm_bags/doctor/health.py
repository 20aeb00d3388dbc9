"""Check whether a bag is fit for calibration: gaps, clocks, types and QoS, topic by topic."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from rosbags.interfaces import QosReliability

from fss_arm_bags.definitions import (
    MEASUREMENTS,
    RECORDERS,
    NotInstalledError,
    definition,
    extends,
)
from fss_arm_bags.reader import BagError, Bags, Topic, two_versions
from fss_arm_ros.convert import SECOND

PERIODS = 5  # periods of a steady topic; a longer silence is a gap
SHORTEST_GAP = 3 * SECOND // 10  # [ns]; a single link publishes every 0.2 s
JUMP = SECOND // 2  # step between stamps and times of receipt that counts as a clock jump [ns]
WINDOW = 2 * SECOND  # in this time at least one message arrives without delay [ns]
APART = 2 * SECOND  # difference of stamps and times of receipt that means two different clocks [ns]

STAMP = struct.Struct(
    "<4xiI"
)  # stamp of a message that starts with a header, little-endian as DDS writes it


@dataclass(frozen=True)
class Stream:
    """Times of receipt and stamps of the messages of a topic."""

    receipts: np.ndarray  # [ns]
    stamps: np.ndarray  # [ns]; empty: the type has no stamp
    begins: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  # of the bags [ns]

    @property
    def within(self) -> np.ndarray:
        """Mask of the messages but the last: True if the next one is in the same bag."""
        return np.diff(np.searchsorted(self.begins, self.receipts, side="right")) == 0

    @property
    def rate(self) -> float:
        """Message rate [Hz]; NaN: fewer than two messages."""
        received = np.diff(self.receipts)[self.within]
        return float(len(received) * SECOND / total) if (total := received.sum()) else np.nan

    @property
    def silences(self) -> np.ndarray:
        """Intervals between successive messages [ns].

        The smaller of two intervals counts, by receipt and by stamp. A recorder that was delayed
        received late, but lost nothing; a clock that jumped forward did not make a pause. The
        interval from one bag to the next is 0 because nothing was recorded.
        """
        received = np.diff(self.receipts) * self.within
        return np.minimum(received, np.diff(self.stamps)) if len(self.stamps) else received

    @property
    def longest_gap(self) -> float:
        """The longest silence [s]; NaN: fewer than two messages."""
        return float(self.silences.max() / SECOND) if len(self.receipts) > 1 else np.nan


def streams(bags: Bags) -> dict[str, Stream]:
    """Return the times of all messages, by topic.

    Raises:
        BagError: a bag is damaged.
    """
    receipts: dict[str, list[int]] = {topic: [] for topic in bags.topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in bags.topics}
    for topic, msgtype, receipt, data in bags.raw():
        receipts[topic].append(receipt)
        if bags.unchecked and not bags.topics[topic].mixed:
            bags.deserialize(data, msgtype)  # raises BagError if the data do not fit the type
        if msgtype in MEASUREMENTS:
            try:
                sec, nanosec = STAMP.unpack_from(data)
            except struct.error:
                raise BagError(f"{topic}: {len(data)} bytes are no {msgtype}") from None
            stamps[topic].append(sec * SECOND + nanosec)
    begins = np.array(bags.begins, np.int64)
    return {
        topic: Stream(
            np.array(receipts[topic], np.int64), np.array(stamps[topic], np.int64), begins
        )
        for topic in receipts
    }


def remark(topic: Topic) -> str:
    """Return a note on a topic that has no problem; empty: there is none."""
    try:
        present = definition(topic.msgtype).hash
    except NotInstalledError:
        return ""
    if topic.mixed or topic.hash in ("", present) or not extends(topic.msgtype, topic.definition):
        return ""
    return "is of an earlier version of its type; replay adds what it lacks"


def findings(topic: Topic, stream: Stream, begin: int) -> Iterator[str]:
    """Yield the problems of a topic, one sentence each; times count from `begin` [ns]."""
    yield from _of_type(topic)
    if topic.msgtype not in MEASUREMENTS:
        return
    if not len(stream.receipts):
        yield "has no messages"
        return
    if any(qos.reliability == QosReliability.BEST_EFFORT for qos in topic.qos):
        yield "was published best effort: messages may have been lost"
    yield from _gaps(stream, begin)
    yield from _clocks(stream, begin)


def _of_type(topic: Topic) -> Iterator[str]:
    """Yield a problem if messages of this type cannot be read as the installed version."""
    try:
        present = definition(topic.msgtype).hash
    except NotInstalledError as error:
        if not topic.msgtype.startswith(RECORDERS):
            yield f"{error}; replay leaves it out"
        return
    if topic.mixed:
        yield f"the bags {two_versions(topic.msgtype)}"
    elif topic.hash not in ("", present) and not extends(topic.msgtype, topic.definition):
        yield f"{topic.msgtype} is installed in another version; replay leaves it out"


def _gaps(stream: Stream, begin: int) -> Iterator[str]:
    """Yield a problem if silences are long for a steady topic."""
    silences = stream.silences
    if not len(silences):
        return
    gaps = np.flatnonzero(silences > max(PERIODS * np.median(silences), SHORTEST_GAP))
    if len(gaps):
        worst = gaps[np.argmax(silences[gaps])]
        yield (
            f"{_count(len(gaps), 'gap')}, the longest of {silences[worst] / SECOND:.3f} s "
            f"at {(stream.receipts[worst] - begin) / SECOND:.3f} s"
        )


def _clocks(stream: Stream, begin: int) -> Iterator[str]:
    """Yield problems of the stamps: jumps against the times of receipt, or another clock."""
    delays = stream.receipts - stream.stamps
    # Least delay in each window: a delayed message carries no information about its clock.
    starts = np.flatnonzero(np.diff((stream.receipts - stream.receipts[0]) // WINDOW, prepend=-1))
    steps = np.diff(np.minimum.reduceat(delays, starts))
    jumps = np.flatnonzero(np.abs(steps) > JUMP)
    if len(jumps):
        around = slice(starts[jumps[0]], np.append(starts, len(delays))[jumps[0] + 2])
        place = around.start + np.argmax(np.abs(np.diff(delays[around]))) + 1
        yield (
            f"{_count(len(jumps), 'jump')} of its clock, the first by "
            f"{-steps[jumps[0]] / SECOND:+.3f} s "
            f"at {(stream.receipts[place] - begin) / SECOND:.3f} s"
        )
    delay = float(np.median(delays)) / SECOND
    if abs(delay) * SECOND > APART:
        yield f"its stamps are {abs(delay):.3f} s {'before' if delay > 0 else 'after'} the receipt"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
