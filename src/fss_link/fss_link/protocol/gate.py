"""Acceptance of commands and segments, for programs that act as a link or the base's board."""

from collections import Counter
from collections.abc import Callable
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

from fss_link.protocol.envelope import CommandFlag, CommandHead, FrameError, Head, newer

C = TypeVar("C", bound=CommandHead)
S = TypeVar("S", bound=Head)


class Refused(Enum):
    """Reason why a datagram is not accepted as a command or a segment of a path."""

    FRAME = "not a frame"
    OTHER = "not to this link"
    BOOT = "for another start"
    SEQUENCE = "not newer than the last"
    EXPIRED = "expired"
    DISARMED = "a segment while disarmed"
    TIME = "a segment of the past, or too far ahead"
    PATH = "a segment of a path that is over"
    INDEX = "a segment beyond those that are kept"
    CONTRADICTION = "a segment that does not fit those that are kept"


class Language(NamedTuple, Generic[C, S]):
    """Commands that one kind of electronics accepts, and segments of paths if it follows any."""

    command: type[C]
    segment: type[S] | None
    decode: Callable[[bytes, bytes | None], Head]  # raises FrameError
    watchdog: int  # silence after which it disarms itself, unless a command sets it [us]


class Gate(Generic[C, S]):
    """Filter that accepts each command once, in order and before it expires.

    Of segments it checks only whether they are for this start of this link, and, if they are
    signed, whether they are later than the last command that did not arm. It does not check
    whether they fit earlier segments.

    Args:
        number: of the link.
        boot: number of this start, 1 to 65535.
        language: commands that the electronics accept.
        key: key that commands must be signed with; None: they must not be signed.
    """

    def __init__(
        self,
        number: int,
        boot: int,
        language: Language[C, S],
        key: bytes | None = None,
    ) -> None:
        self.number, self.boot, self.key, self._language = number, boot, key, language
        self.refused: Counter[Refused] = Counter()
        self.command: C | None = None  # the last accepted command
        self.arrival = 0  # of that command, in the link's clock [us]
        self._newest = 0  # newest accepted sequence
        self._latest = -1  # latest accepted stamp of the computer [us]
        self._disarming = -1  # stamp of the last command that did not arm

    @property
    def watchdog(self) -> int:
        """Silence after which the link disarms itself [us]."""
        return 1000 * self.command.watchdog if self.command else self._language.watchdog

    def accept(self, data: bytes, clock: int) -> C | S | None:
        """Return the command or segment received at `clock` [us]; None if it is refused."""
        frame = self._check(data, clock)
        if isinstance(frame, Refused):
            self.count_refusal(frame)
            return None
        if isinstance(frame, self._language.command):
            self._store(frame, clock)
        return frame

    def count_refusal(self, reason: Refused) -> None:
        """Count a datagram that is refused."""
        self.refused[reason] += 1

    def _check(self, data: bytes, clock: int) -> C | S | Refused:
        try:
            frame = self._language.decode(data, self.key)
        except FrameError:
            return Refused.FRAME
        segment = self._language.segment
        if frame.link == self.number and segment and isinstance(frame, segment):
            return self._segment_refusal(frame) or frame
        if frame.link == self.number and isinstance(frame, self._language.command):
            return self._command_refusal(frame, clock) or frame
        return Refused.OTHER

    def _segment_refusal(self, segment: S) -> Refused | None:
        if segment.boot != self.boot:
            return Refused.BOOT
        return Refused.SEQUENCE if self.key and segment.clock <= self._disarming else None

    def _command_refusal(self, command: C, clock: int) -> Refused | None:
        stop = command.flags & CommandFlag.STOP
        if not stop and command.boot not in (0, self.boot):
            return Refused.BOOT
        if self._is_replayed(command) or not (stop or self._follows(command, clock)):
            return Refused.SEQUENCE
        return Refused.EXPIRED if command.expiry and command.expiry < clock else None

    def _store(self, command: C, clock: int) -> None:
        if self._follows(command, clock):
            self._newest = command.sequence
        self._latest = max(self._latest, command.clock)
        if not command.flags & CommandFlag.ARM:
            self._disarming = command.clock
        self.command, self.arrival = command, clock

    def _follows(self, command: C, clock: int) -> bool:
        """Return True if the command is newer than the last one, or may start a session."""
        if self.command is None or clock - self.arrival > self.watchdog:
            return not command.flags & CommandFlag.ARM
        return newer(command.sequence, self._newest)

    def _is_replayed(self, command: C) -> bool:
        """Return True if a signed command is not later than every accepted command."""
        return bool(self.key) and command.clock <= self._latest
