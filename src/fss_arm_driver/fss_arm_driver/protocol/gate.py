"""Which commands and segments a link takes, for whatever plays a link."""

from collections import Counter
from enum import Enum

from fss_arm_driver.protocol.frames import (
    Command,
    FrameError,
    Order,
    Segment,
    Telemetry,
    decode,
    newer,
)

WATCHDOG = 2_000_000  # until a command says otherwise [us]


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


class Gate:
    """Lets through each command once, in order and in time, from the start of a link on.

    Of segments it knows whether they are meant for this start of this link; how they fit what
    came before is the path's to judge.

    Args:
        number: of the link.
        boot: which start this is, 1 to 65535.
        key: that commands must be signed under; None: they must not be signed.
    """

    def __init__(self, number: int, boot: int, key: bytes | None = None) -> None:
        self.number, self.boot, self.key = number, boot, key
        self.refused: Counter[Refused] = Counter()
        self.command: Command | None = None  # the last one taken
        self.arrival = 0  # of that command, by the link's clock [us]
        self._newest = 0  # sequence
        self._latest = -1  # stamp of the computer [us]
        self._disarming = -1  # that of the last command that did not arm

    @property
    def watchdog(self) -> int:
        """Silence after which the link disarms itself [us]."""
        return 1000 * self.command.watchdog if self.command else WATCHDOG

    def take(self, data: bytes, clock: int) -> Command | Segment | None:
        """What these bytes are, come at `clock` [us]; None if they are not taken."""
        frame = self._judge(data, clock)
        if isinstance(frame, Refused):
            self.refuse(frame)
            return None
        if isinstance(frame, Command):
            self._remember(frame, clock)
        return frame

    def refuse(self, reason: Refused) -> None:
        """Count a datagram that is not taken."""
        self.refused[reason] += 1

    def _judge(self, data: bytes, clock: int) -> Command | Segment | Refused:
        try:
            frame = decode(data, self.key)
        except FrameError:
            return Refused.FRAME
        if isinstance(frame, Telemetry) or frame.link != self.number:
            return Refused.OTHER
        if isinstance(frame, Segment):
            return self._segment_obstacle(frame) or frame
        return self._command_obstacle(frame, clock) or frame

    def _segment_obstacle(self, segment: Segment) -> Refused | None:
        if segment.boot != self.boot:
            return Refused.BOOT
        return Refused.SEQUENCE if self.key and segment.clock <= self._disarming else None

    def _command_obstacle(self, command: Command, clock: int) -> Refused | None:
        stop = command.flags & Order.STOP
        if not stop and command.boot not in (0, self.boot):
            return Refused.BOOT
        if self._is_replayed(command) or not (stop or self._follows(command, clock)):
            return Refused.SEQUENCE
        return Refused.EXPIRED if command.expiry and command.expiry < clock else None

    def _remember(self, command: Command, clock: int) -> None:
        if self._follows(command, clock):
            self._newest = command.sequence
        self._latest = max(self._latest, command.clock)
        if not command.flags & Order.ARM:
            self._disarming = command.clock
        self.command, self.arrival = command, clock

    def _follows(self, command: Command, clock: int) -> bool:
        """Whether it is newer than the last command, or may begin a session."""
        if self.command is None or clock - self.arrival > self.watchdog:
            return not command.flags & Order.ARM
        return newer(command.sequence, self._newest)

    def _is_replayed(self, command: Command) -> bool:
        """Whether a signed command is not later than all that were taken."""
        return bool(self.key) and command.clock <= self._latest
