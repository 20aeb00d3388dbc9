"""Timed paths that are sent ahead to a link, and the record of the segments that it has.

The link follows one path and stores the next one; a path that has ended cannot be resumed
(docs/reference/protocol.md). Times are in the link's clock [us].
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence

from fss_arm_driver.knots import Knot
from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    MAX_SEGMENTS,
    Segment,
    Slow,
    Telemetry,
    evaluate,
    newer_path,
)
from fss_link.session import CommandError

SEND_AHEAD = 4_000_000  # segments that start later are not sent yet [us]
MAX_SENT = 12  # most segments sent at once
START_TOLERANCE = 10_000  # largest difference of the start times of one path given twice [us]
MARGIN = 2  # segments by which the link may lag


class SentPath:
    """One path, with its knots timed by the link's clock.

    Args:
        link: number of the link.
        boot: of the link.
        number: of the path.
        begin: start, in the link's clock [us].
        rate: rate of the link's clock relative to the clock of the knots.
        knots: of the path.
        given: when it was given, in the caller's clock.
    """

    def __init__(
        self,
        link: int,
        boot: int,
        number: int,
        begin: int,
        rate: float,
        knots: Sequence[Knot],
        given: int,
    ) -> None:
        self.number, self.knots, self.given = number, knots, given
        self.clocks = [begin + round(rate * knot.time) for knot in knots]
        self.missing = 0  # index of the first segment that the link has not reported
        self._link, self._boot = link, boot

    @property
    def start(self) -> int:
        """Start in the link's clock [us]."""
        return self.clocks[0]

    @property
    def end(self) -> int:
        """End in the link's clock [us]."""
        return self.clocks[-1]

    def segment_index(self, clock: int) -> int:
        """Return the index of the segment at a time; before the start, that of the first."""
        return max(0, bisect_right(self.clocks, clock) - 1)

    def segment(self, index: int) -> Segment:
        """Return one segment, without sequence and stamp."""
        (_, q0, qd0), (_, q1, qd1) = self.knots[index : index + 2]
        begin, end = self.clocks[index : index + 2]
        return Segment(
            link=self._link,
            flags=LAST_SEGMENT if index + 2 == len(self.knots) else 0,
            boot=self._boot,
            sequence=0,
            clock=0,
            path=self.number,
            index=index,
            begin=begin,
            duration=end - begin,
            position=q0,
            velocity=qd0,
            end_position=q1,
            end_velocity=qd1,
        )

    def due(self, clock: int) -> Iterator[Segment]:
        """Yield the segments to send now, the most urgent first."""
        present = self.segment_index(clock)
        end = min(bisect_left(self.clocks, clock + SEND_AHEAD), len(self.clocks) - 1)
        for index in range(max(present, self.missing), min(end, present + MAX_SEGMENTS - MARGIN)):
            yield self.segment(index)

    def position(self, clock: int) -> float:
        """Return the desired position of the joint at a time [counts]."""
        last = len(self.clocks) - 2
        segment = self.segment(min(self.segment_index(clock), last))
        return evaluate(segment, min(max(clock, segment.begin), segment.end))[0]


class Paths:
    """Paths that are sent to one link while it is armed."""

    def __init__(self) -> None:
        self.followed: SentPath | None = None
        self.next: SentPath | None = None
        self.last = 0  # number of the path followed last; 0: none

    def find(self, number: int) -> SentPath | None:
        """Return the path of that number, or None if it has ended or is not known."""
        for path in (self.followed, self.next):
            if path and path.number == number:
                return path
        return None

    def check(self, number: int) -> None:
        """Raise CommandError if the path of that number has ended."""
        if self.last and not self.find(number) and not newer_path(number, self.last):
            raise CommandError(f"path {number} has ended, expected one newer than {self.last}")

    def add(self, path: SentPath) -> None:
        """Accept a path as the next one.

        Raises:
            CommandError: it has ended, is older than the next one, or differs from an earlier path
                of the same number.
        """
        self.check(path.number)
        known = self.find(path.number)
        if known is None and self.next and not newer_path(path.number, self.next.number):
            raise CommandError(f"path {path.number} is older than path {self.next.number}")
        if known is None:
            self.next = path
        elif known.knots != path.knots or abs(known.start - path.start) > START_TOLERANCE:
            raise CommandError(
                f"path {path.number} was given before with other knots or another start"
            )

    def tick(self, commanded: int, clock: int) -> None:
        """Advance to time `clock`; the link must follow the path `commanded`, 0: none."""
        if commanded != self.last and not (commanded and newer_path(commanded, self.last)):
            self.followed = None
        if self.next and commanded == self.next.number and clock >= self.next.start:
            self.followed, self.next, self.last = self.next, None, commanded

    def update(self, frame: Telemetry, echoed: int | None) -> None:
        """Update which segments the link has, from telemetry.

        The frame echoes a command sent at `echoed`.
        """
        word = frame.slow_value & 0xFFFFFFFF
        path = self.find(word >> 16) if frame.slow_id == Slow.PATH else None
        if path and echoed is not None and echoed >= path.given:
            path.missing = word & 0xFFFF

    def due(self, clock: int) -> list[Segment]:
        """Return the segments to send now, at most MAX_SENT."""
        paths = [path for path in (self.followed, self.next) if path]
        due = [segment for path in paths for segment in path.due(clock)]
        return sorted(due, key=lambda segment: segment.begin)[:MAX_SENT]
