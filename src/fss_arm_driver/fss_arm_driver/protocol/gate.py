"""Which commands a link takes: the link's side of the protocol, for whatever plays a link."""

from collections import Counter
from enum import Enum

from fss_arm_driver.protocol.frames import Command, FrameError, Order, decode, newer

WATCHDOG = 2_000_000  # until a command says otherwise [us]


class Refused(Enum):
    """Why a datagram is not taken as a command."""

    FRAME = "not a frame"
    OTHER = "not a command to this link"
    BOOT = "for another start"
    SEQUENCE = "not newer than the last"
    EXPIRED = "expired"


class Gate:
    """Lets through each command once, in order and in time, from the start of a link on.

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

    @property
    def watchdog(self) -> int:
        """Silence after which the link disarms itself [us]."""
        return 1000 * self.command.watchdog if self.command else WATCHDOG

    def take(self, data: bytes, clock: int) -> Command | None:
        """The command that these bytes are, come at `clock` [us]; None if it is not taken."""
        try:
            command = decode(data, self.key)
        except FrameError:
            return self._refuse(Refused.FRAME)
        if not isinstance(command, Command) or command.link != self.number:
            return self._refuse(Refused.OTHER)
        stop, follows = command.flags & Order.STOP, self._follows(command, clock)
        if not stop and command.boot not in (0, self.boot):
            return self._refuse(Refused.BOOT)
        if self._is_replayed(command) or not (stop or follows):
            return self._refuse(Refused.SEQUENCE)
        if command.expiry and command.expiry < clock:
            return self._refuse(Refused.EXPIRED)
        if follows:
            self._newest = command.sequence
        self._latest = max(self._latest, command.clock)
        self.command, self.arrival = command, clock
        return command

    def _follows(self, command: Command, clock: int) -> bool:
        """Whether it is newer than the last command, or may begin a session."""
        if self.command is None or clock - self.arrival > self.watchdog:
            return not command.flags & Order.ARM
        return newer(command.sequence, self._newest)

    def _is_replayed(self, command: Command) -> bool:
        """Whether a signed command is not later than all that were taken."""
        return bool(self.key) and command.clock <= self._latest

    def _refuse(self, reason: Refused) -> Command | None:
        self.refused[reason] += 1
        return None
