"""Timed paths that a link stores and follows autonomously (docs/reference/protocol.md).

A `PathFollower` is the link's side: it receives segments and computes velocities for the drive, in
counts. Times are in the link's clock [us].
"""

from typing import NamedTuple

from fss_arm_driver.protocol.frames import LAST_SEGMENT, VELOCITY_UNIT, Command, Segment
from fss_link.protocol.gate import Refused

MAX_SEGMENTS = 32  # most segments stored of a path
MAX_LEAD = 120_000_000  # longest time by which a segment may start ahead [us]
GAIN = 4.0  # of the correction [1/s]
# A path is aborted when the error exceeds its velocity limit times this [s].
MAX_ERROR_TIME = 0.25
REST_VELOCITY = 100.0  # a slower joint is at rest [counts/s]


def hermite(
    t: float, duration: float, p0: float, v0: float, p1: float, v1: float
) -> tuple[float, float]:
    """Return position and velocity of a cubic Hermite polynomial, `t` after its start.

        p(s) = p0 + s (T v0 + s (3 D - T (2 v0 + v1) + s (T (v0 + v1) - 2 D)))

    with s = t / T from 0 to 1, T = `duration` and D = p1 - p0; p0, v0, p1 and v1 are position and
    velocity at its ends.
    """
    s, rise = t / duration, p1 - p0
    a, b = duration * v0, duration * v1
    square, cube = 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise
    position = p0 + s * (a + s * (square + s * cube))
    return position, (a + s * (2.0 * square + s * 3.0 * cube)) / duration


def newer_path(number: int, than: int) -> bool:
    """Return True if a path's number is later than another, modulo 2^16."""
    return 0 < (number - than) & 0xFFFF < 0x8000


class PathPoint(NamedTuple):
    """Point of a path at a time."""

    position: float  # [counts]
    velocity: float  # [counts/s]
    ended: bool  # the last knot has passed


class StoredPath:
    """Stored segments of one path that have not yet ended."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.first = 0  # index of the earliest segment that is still accepted
        self._segments: dict[int, Segment] = {}  # by index

    @property
    def missing(self) -> int:
        """Index of the first segment that is not stored."""
        index = self.first
        while index in self._segments:
            index += 1
        return index

    def store(self, new: Segment) -> Refused | None:
        """Store a segment, or return why it is refused."""
        if not self.first <= new.index < self.first + MAX_SEGMENTS:
            return Refused.INDEX
        for held in self._segments.values():
            early, late = sorted((held, new), key=lambda segment: segment.index)
            differs = early.index == late.index and _contents(held) != _contents(new)
            beyond_end = early.index < late.index and early.flags & LAST_SEGMENT
            apart = early.index + 1 == late.index and _end_knot(early) != _start_knot(late)
            if differs or beyond_end or apart:
                return Refused.CONTRADICTION
        self._segments.setdefault(new.index, new)
        return None

    def has_started(self, clock: int) -> bool:
        """Return True if the first stored segment has started."""
        return bool(self._segments) and clock >= self._segments[min(self._segments)].begin

    def advance(self, clock: int, lead: int = 0) -> PathPoint | None:
        """Return the point of the path now; None if no segment is stored for this time.

        Segments that end before `clock` are deleted.

        Args:
            clock: now [us].
            lead: time ahead at which the velocity is evaluated, at most at the segment's end [us].
        """
        for index in sorted(self._segments):
            segment = self._segments[index]
            if clock < segment.begin:
                return None
            ended = clock >= segment.end
            if ended and not segment.flags & LAST_SEGMENT:
                del self._segments[index]
                continue
            self.first = index
            position, _ = evaluate(segment, min(clock, segment.end))
            _, velocity = evaluate(segment, min(clock + lead, segment.end))
            return PathPoint(position, velocity, ended)
        return None


def evaluate(segment: Segment, clock: int) -> tuple[float, float]:
    """Return position [counts] and velocity [counts/s] of a segment at a time within it [us]."""
    return hermite(
        1e-6 * (clock - segment.begin),
        1e-6 * segment.duration,
        segment.position,
        VELOCITY_UNIT * segment.velocity,
        segment.end_position,
        VELOCITY_UNIT * segment.end_velocity,
    )


def _start_knot(segment: Segment) -> tuple[int, int, int]:
    """Return time, position and velocity at the start of a segment."""
    return segment.begin, segment.position, segment.velocity


def _end_knot(segment: Segment) -> tuple[int, int, int]:
    """Return time, position and velocity at the end of a segment."""
    return segment.end, segment.end_position, segment.end_velocity


def _contents(segment: Segment) -> tuple[int, ...]:
    """Return the contents of a segment: whether it is the last, its start, its end."""
    return segment.flags, *_start_knot(segment), *_end_knot(segment)


class PathFollower:
    """Controller that stores the active path of a link and the next one, and follows them.

    `LinkState` replaces it whenever the link is disarmed. `following` and `broken` are as in
    telemetry.
    """

    def __init__(self) -> None:
        self.following = self.broken = False
        self._followed: StoredPath | None = None
        self._next: StoredPath | None = None
        self._last = 0  # number of the path followed last, even if deleted; 0: none

    @property
    def followed(self) -> int:
        """Number of the active path, also after its last knot; 0: none."""
        return self._followed.number if self._followed else 0

    @property
    def report(self) -> int:
        """Value of slow field 8, PATH."""
        path = self._next or self._followed
        word = path.number << 16 | path.missing if path else 0
        return (word ^ 1 << 31) - (1 << 31)  # as a signed number of 32 bits

    def store(self, segment: Segment, clock: int) -> Refused | None:
        """Store a segment received at `clock`, or return why it is refused."""
        if segment.end <= clock or segment.begin > clock + MAX_LEAD:
            return Refused.TIME
        for path in (self._followed, self._next):
            if path and segment.path == path.number:
                return path.store(segment)
        known = self._last, self._next.number if self._next else 0
        if not all(newer_path(segment.path, number) for number in known if number):
            return Refused.PATH
        path = StoredPath(segment.path)
        if why := path.store(segment):
            return why
        self._next = path
        return None

    def abandon(self) -> None:
        """Delete the active path, because the link must do something else."""
        self.following, self._followed = False, None

    def follow(
        self, command: Command, clock: int, position: float, velocity: float, lead: int = 0
    ) -> float | None:
        """Return the velocity set point of the drive [counts/s]; None: the drive must hold.

        Args:
            command: the active command, of mode PATH.
            clock: now [us].
            position: of the joint [counts].
            velocity: of it [counts/s].
            lead: time until half of the commanded velocity step is reached [us].
        """
        number, limit = command.set_point, VELOCITY_UNIT * command.velocity
        if self._next and number == self._next.number:
            if self._next.has_started(clock):
                self._followed, self._next, self._last = self._next, None, number
                self.following, self.broken = True, False
        elif number != self._last and self._last and not newer_path(number, self._last):
            self.abandon()  # an older path is commanded, which cannot be resumed
        if self._followed is None:
            return None
        point = self._followed.advance(clock, lead)
        error = point.position - position if point else 0.0
        if point is None or abs(error) > MAX_ERROR_TIME * limit:
            self.abandon()
            self.broken = True
            return None
        if point.ended and abs(velocity) < REST_VELOCITY:
            self.following = False
        return max(-limit, min(point.velocity + GAIN * error, limit))
