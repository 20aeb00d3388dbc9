"""Which commands and segments a link takes, for whatever plays a link or the base's board."""

from collections import Counter
from collections.abc import Callable
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

from fss_arm_driver.protocol.envelope import FrameError, Head, Ordered, newer
from fss_arm_driver.protocol.frames import Command, Order, Segment, decode

C = TypeVar("C", bound=Ordered)


class Refused(Enum):
    """Why a datagram is not taken as a command, or a segment of a path."""

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


class Language(NamedTuple, Generic[C]):
    """What one kind of electronics is told."""

    command: type[C]
    decode: Callable[[bytes, bytes | None], Head]  # or FrameError
    watchdog: int  # silence after which it disarms itself until a command says otherwise [us]


LINK = Language(Command, decode, 2_000_000)


class Gate(Generic[C]):
    """Lets through each command once, in order and in time, from the start of a link on.

    Of all else, as segments, it knows whether it is meant for this start of this link; how it fits
    what came before is for others to judge.

    Args:
        number: of the link.
        boot: which start this is, 1 to 65535.
        key: that commands must be signed under; None: they must not be signed.
        language: that it understands.
    """

    def __init__(
        self,
        number: int,
        boot: int,
        key: bytes | None = None,
        language: "Language[C]" = LINK,  # type: ignore[assignment]
    ) -> None:
        self.number, self.boot, self.key, self._language = number, boot, key, language
        self.refused: Counter[Refused] = Counter()
        self.command: C | None = None  # the last one taken
        self.arrival = 0  # of that command, by the link's clock [us]
        self._newest = 0  # sequence
        self._latest = -1  # stamp of the computer [us]
        self._disarming = -1  # that of the last command that did not arm

    @property
    def watchdog(self) -> int:
        """Silence after which the link disarms itself [us]."""
        return 1000 * self.command.watchdog if self.command else self._language.watchdog

    def take(self, data: bytes, clock: int) -> C | Segment | None:
        """What these bytes are, come at `clock` [us]; None if they are not taken."""
        frame = self._judge(data, clock)
        if isinstance(frame, Refused):
            self.refuse(frame)
            return None
        if not isinstance(frame, Segment):  # so a command
            self._remember(frame, clock)
        return frame

    def refuse(self, reason: Refused) -> None:
        """Count a datagram that is not taken."""
        self.refused[reason] += 1

    def _judge(self, data: bytes, clock: int) -> C | Segment | Refused:
        try:
            frame = self._language.decode(data, self.key)
        except FrameError:
            return Refused.FRAME
        if frame.link == self.number and isinstance(frame, Segment):
            return self._segment_obstacle(frame) or frame
        if frame.link == self.number and isinstance(frame, self._language.command):
            return self._command_obstacle(frame, clock) or frame
        return Refused.OTHER

    def _segment_obstacle(self, segment: Segment) -> Refused | None:
        if segment.boot != self.boot:
            return Refused.BOOT
        return Refused.SEQUENCE if self.key and segment.clock <= self._disarming else None

    def _command_obstacle(self, command: C, clock: int) -> Refused | None:
        stop = command.flags & Order.STOP
        if not stop and command.boot not in (0, self.boot):
            return Refused.BOOT
        if self._is_replayed(command) or not (stop or self._follows(command, clock)):
            return Refused.SEQUENCE
        return Refused.EXPIRED if command.expiry and command.expiry < clock else None

    def _remember(self, command: C, clock: int) -> None:
        if self._follows(command, clock):
            self._newest = command.sequence
        self._latest = max(self._latest, command.clock)
        if not command.flags & Order.ARM:
            self._disarming = command.clock
        self.command, self.arrival = command, clock

    def _follows(self, command: C, clock: int) -> bool:
        """Whether it is newer than the last command, or may begin a session."""
        if self.command is None or clock - self.arrival > self.watchdog:
            return not command.flags & Order.ARM
        return newer(command.sequence, self._newest)

    def _is_replayed(self, command: C) -> bool:
        """Whether a signed command is not later than all that were taken."""
        return bool(self.key) and command.clock <= self._latest
