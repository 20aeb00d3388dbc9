"""Acceptance of a link's telemetry, and detection of its loss (docs/reference/protocol.md)."""

from collections import Counter, deque
from enum import Enum
from typing import Generic, NamedTuple, Protocol, TypeVar

from fss_arm_model.units import SECOND
from fss_link.protocol import TelemetryHead, newer
from fss_link.session.clock import MICROSECOND, LinkClock

EARLY_TOLERANCE = SECOND // 10  # delays vary: the most by which a frame may seem to be early
TRACK_MEMORY = 60 * SECOND  # for which a lost link and its clock are remembered
SHORTEST_PERIOD = 1000  # of telemetry, in the link's clock [us]
MAX_CANDIDATES = 16  # more than one, so that noise cannot displace a link that starts


T = TypeVar("T", bound=TelemetryHead)
F = TypeVar("F", bound=TelemetryHead, contravariant=True)


class Rules(Protocol[F]):
    """Validity rules for telemetry frames."""

    def is_plausible(self, frame: F) -> bool:
        """Return True if the frame is plausible by itself."""

    def is_reachable(self, before: F, frame: F) -> bool:
        """Return True if the frame can follow the frame `before`."""


class Verdict(Enum):
    """Result of the comparison of a frame with an earlier one of the same link."""

    FOLLOWS = "follows"
    STALE = "stale"
    REPEATED = "repeated"
    REORDERED = "reordered"
    JUMP = "jump"


class Track(NamedTuple, Generic[T]):
    """Last frame of a link, the estimate of its clock, and the usual period of its frames."""

    frame: T
    clock: LinkClock
    period: float = 0.0  # in the link's clock [us]; 0: not known yet

    def then(self, frame: T) -> "Track[T]":
        """Return the track with its next frame; a single late frame hardly changes the period."""
        steps = (frame.sequence - self.frame.sequence) & 0xFFFFFFFF
        last = (frame.clock - self.frame.clock) / steps
        if 0.0 < self.period < last:
            last = self.period + (min(last, 2.0 * self.period) - self.period) / 8
        return Track(frame, self.clock, last)


class Reception(Generic[T]):
    """Filter that compares each frame with earlier ones. Times are the caller's, in nanoseconds.

    Args:
        rules: validity rules for its frames.
        timeout: silence after which the link is lost [ns].
        resolution: step of the clock that the caller reads [ns].
        prove: accept only frames that echo this session's commands, because signed frames may
            be a recording.
        counts: numbers of frames by outcome.
    """

    def __init__(
        self, rules: Rules[T], timeout: int, resolution: int, prove: bool, counts: Counter[str]
    ) -> None:
        self.lost = True
        self.accepted_at = 0  # when a frame was last accepted
        self.track: Track[T] | None = None  # of accepted frames; kept for a while when lost
        self._rules, self._timeout, self._resolution = rules, timeout, resolution
        self._early = timeout if resolution else EARLY_TOLERANCE  # a simulated clock may lag
        self._prove, self._counts = prove, counts
        self._candidates: deque[Track[T]] = deque(maxlen=MAX_CANDIDATES)  # on probation
        self._stamp = 0  # of the last sample
        self._echoed = 0  # when the command echoed by the last accepted frame was sent

    def tick(self, now: int, min_timeout: int = 0) -> bool:
        """Return True if the link is lost at `now`, but was not before.

        `min_timeout` is the shortest timeout.
        """
        lost = not self.lost and now - self.accepted_at > max(self._timeout, min_timeout)
        if lost:
            self.lost = True
            self._counts["lost"] += 1
        if self.lost and now - self.accepted_at > TRACK_MEMORY:
            self.track = None
        return lost

    def reset(self, now: int) -> None:
        """Reset, because the clock was set back."""
        self._counts["lost"] += not self.lost
        self.lost, self.accepted_at, self.track, self._stamp, self._echoed = True, now, None, 0, 0
        self._candidates.clear()

    def accept(self, frame: T, echoed: int | None, now: int) -> int | None:
        """Return the host time of the measurement [ns] if `frame` is accepted, else None.

        The frame echoes a command sent at `echoed`.
        """
        if not self._check(frame, echoed, now) or self.track is None:
            return None
        clock = self.track.clock
        if echoed is None:
            clock.one_way(frame.clock, now)
        else:
            clock.exchange(echoed, frame.turnaround, frame.clock, now)
            self._echoed = echoed
        # The stamps increase even when the clock estimate is corrected.
        self._stamp = max(clock.to_host(frame.clock), self._stamp + 1)
        return self._stamp

    def _check(self, frame: T, echoed: int | None, now: int) -> bool:
        """Return True if `frame` is accepted; it becomes the track's last frame or a candidate."""
        if not self._rules.is_plausible(frame):
            self._counts["impossible"] += 1
            return False
        verdict = self._compare(self.track, frame, now, late=self._timeout)
        if self.lost and verdict is Verdict.STALE:  # all are if the host's clock was set forward
            verdict = Verdict.JUMP
        if verdict not in (Verdict.FOLLOWS, Verdict.JUMP):
            self._counts[verdict.value] += 1
            return False
        follows = verdict is Verdict.FOLLOWS and not self.lost
        if self._prove and not self._is_proven(frame, echoed, now, follows):
            self._counts["unproven"] += 1
            return False
        return self._follow(verdict, frame, now)

    def _is_proven(self, frame: T, echoed: int | None, now: int, follows: bool) -> bool:
        """Return True if the echo shows that `frame` is not a recording.

        A link accepts commands in order, so its echoes never go back. A frame that does not follow
        the track must also be measured within the timeout, by the echo and its turnaround.
        """
        if echoed is None or echoed < self._echoed:
            return False
        return follows or now - echoed - frame.turnaround * MICROSECOND <= self._timeout

    def _follow(self, verdict: Verdict, frame: T, now: int) -> bool:
        """Accept a frame that follows the track or a candidate; else store it as a candidate."""
        if self.track and verdict is Verdict.FOLLOWS:
            self._accept(self.track, frame, now)
            return True
        for track in self._candidates if self.lost else ():
            if self._compare(track, frame, now, late=self._early) is Verdict.FOLLOWS:
                self._accept(track, frame, now)
                return True
        self._counts["candidates"] += 1
        self._candidates.append(Track(frame, LinkClock(frame.clock, now, self._resolution)))
        return False

    def _compare(self, track: Track[T] | None, frame: T, now: int, late: int) -> Verdict:
        """Compare `frame` with `track`; a frame older than `late` [ns] is stale."""
        if track is None or frame.boot != track.frame.boot:
            return Verdict.JUMP
        age = now - track.clock.to_host(frame.clock)
        if age > late:
            return Verdict.STALE
        if frame.sequence == track.frame.sequence:
            return Verdict.REPEATED
        if not newer(frame.sequence, track.frame.sequence):
            return Verdict.REORDERED
        period = frame.clock - track.frame.clock
        steps = (frame.sequence - track.frame.sequence) & 0xFFFFFFFF
        # The missed frames take time, so a shorter period is a jump of the sequence.
        least = max(steps * SHORTEST_PERIOD, (steps - 1) * track.period / 2)
        if period < least or (age < -self._early and self._is_early(track, age, now)):
            return Verdict.JUMP
        reachable = self._rules.is_reachable(track.frame, frame)
        return Verdict.FOLLOWS if reachable else Verdict.JUMP

    def _is_early(self, track: Track[T], age: int, now: int) -> bool:
        """Return True if a frame is early even beyond the clock's uncertainty."""
        uncertainty = track.clock.half_width(now)
        return age < -self._early - (uncertainty if uncertainty < self._timeout else 0)

    def _accept(self, track: Track[T], frame: T, now: int) -> None:
        self._counts["adopted"] += self.lost
        self._counts["accepted"] += 1
        self._counts["missed"] += ((frame.sequence - track.frame.sequence) & 0xFFFFFFFF) - 1
        # A silent link may not have counted its frames: its period is estimated again.
        self.track = Track(frame, track.clock) if self.lost else track.then(frame)
        self._candidates.clear()
        self.accepted_at, self.lost = now, False
