"""What a link is to do, by the commands that it takes and the time that passes."""

from enum import Enum

from fss_arm_driver.protocol.frames import Order, State
from fss_arm_driver.protocol.gate import Gate


class Goal(Enum):
    """What the servo drive is to do."""

    RELEASE = "decelerate, then switch off"
    HOLD = "decelerate, then hold that place"
    OBEY = "what the last command says"


class LinkState:
    """Whether a link is armed, and its latches. Clocks are the link's own [us].

    Args:
        gate: that commands come through.
    """

    def __init__(self, gate: Gate) -> None:
        self.gate = gate
        self.armed = self.stopped = self.watchdog_tripped = False
        self._dropped = False  # by a fault; not in telemetry
        self._on = False  # the drive, from arming on: no stop switches it on

    def receive(self, data: bytes, clock: int) -> bool:
        """Take or refuse bytes that have come; whether they were taken."""
        command = self.gate.take(data, clock)
        if command is None:
            return False
        if command.flags & Order.STOP:
            self.armed, self.stopped = False, True
        elif not command.flags & Order.ARM:
            self.disarm()
        elif not (self.stopped or self.watchdog_tripped or self._dropped):
            self.armed = self._on = True
        return True

    def disarm(self) -> None:
        """Brake, then off; latches are forgotten."""
        self.armed = self.stopped = self.watchdog_tripped = self._dropped = self._on = False

    def drop(self) -> None:
        """The drive has a fault or does not answer: off, also if it only holds, until disarmed."""
        if self._on:
            self._dropped, self.armed, self._on = True, False, False

    def goal(self, clock: int) -> Goal:
        """What to do now; lets the watchdog trip."""
        gate, command = self.gate, self.gate.command
        if self.armed and clock - gate.arrival > gate.watchdog:
            self.armed, self.watchdog_tripped = False, True
        if not (self._on and command):
            return Goal.RELEASE
        obeys = self.armed and command.expiry >= clock and not command.flags & Order.HOLD
        return Goal.OBEY if obeys else Goal.HOLD

    def flags(self, referenced: bool) -> int:
        """As telemetry has them."""
        return (
            State.ARMED * self.armed
            | State.STOPPED * self.stopped
            | State.WATCHDOG * self.watchdog_tripped
            | State.REFERENCED * referenced
        )
