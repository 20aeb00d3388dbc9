"""State of a link, from the commands that it accepts and the time."""

from collections.abc import Sequence
from enum import Enum

from fss_arm_driver.protocol.frames import (
    VELOCITY_UNIT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    State,
    decode,
)
from fss_arm_driver.protocol.path import PathFollower
from fss_link.protocol import Gate, Language, Refused


class Goal(Enum):
    """Goal of the servo drive."""

    RELEASE = "decelerate, then switch off"
    HOLD = "decelerate, then hold that place"
    OBEY = "what the last command says"
    FOLLOW = "what `LinkState.velocity` says, at least 50 times a second"


LINK_LANGUAGE = Language(Command, Segment, decode, 2_000_000)


def link_gate(number: int, boot: int, key: bytes | None = None) -> Gate[Command, Segment]:
    """Return the gate for commands to link `number`; `boot` identifies its start, 1 to 65535."""
    return Gate(number, boot, LINK_LANGUAGE, key)


class LinkState:
    """State of a link: armed or not, latches and paths. Times are in the link's clock [us].

    Args:
        gate: filter of the received commands.
    """

    def __init__(self, gate: Gate[Command, Segment]) -> None:
        self.gate = gate
        self.armed = self.stopped = self.watchdog_tripped = False
        self.paths = PathFollower()
        self._dropped = False  # disarmed by a fault; not in telemetry
        self._on = False  # the drive is on since arming: a stop does not switch it on

    def receive(self, data: bytes, clock: int) -> bool:
        """Process received bytes; return True if they were accepted as a command."""
        command = self.gate.accept(data, clock)
        if isinstance(command, Segment):
            self._store_segment(command, clock)
        if not isinstance(command, Command):
            return False
        if command.flags & LinkCommandFlag.STOP:
            self.armed, self.stopped = False, True
        elif not command.flags & LinkCommandFlag.ARM:
            self.disarm()
        elif not (self.stopped or self.watchdog_tripped or self._dropped):
            self.armed = self._on = True
        if not self.armed:
            self.paths = PathFollower()
        return True

    def _store_segment(self, segment: Segment, clock: int) -> None:
        """Store a segment of a path, or refuse it."""
        self._check_watchdog(clock)
        why = self.paths.store(segment, clock) if self.armed else Refused.DISARMED
        if why:
            self.gate.count_refusal(why)

    def disarm(self) -> None:
        """Disarm and clear the latches: the drive brakes, then switches off."""
        self.armed = self.stopped = self.watchdog_tripped = self._dropped = self._on = False

    def drop(self) -> None:
        """Handle a drive that has a fault or does not answer: switch it off until disarmed."""
        if self._on:
            self._dropped, self.armed, self._on = True, False, False

    def goal(self, clock: int) -> Goal:
        """Return the present goal, after a check of the watchdog."""
        command = self.gate.command
        self._check_watchdog(clock)
        if not self.armed:
            self.paths = PathFollower()
        if not (self._on and command):
            return Goal.RELEASE
        obeys = self.armed and command.expiry >= clock and not command.flags & LinkCommandFlag.HOLD
        if obeys and command.mode == Mode.PATH and not command.flags & LinkCommandFlag.HOME:
            return Goal.FOLLOW
        self.paths.abandon()
        return Goal.OBEY if obeys else Goal.HOLD

    def velocity(self, clock: int, position: float, velocity: float, lead: int = 0) -> int | None:
        """Return the drive's velocity set point on a path [0.1 counts/s]; None: it must hold.

        Args:
            clock: now.
            position: of the joint [counts].
            velocity: of the joint [0.1 counts/s].
            lead: the time until half of what is said is done [us].
        """
        assert self.gate.command
        speed = VELOCITY_UNIT * velocity
        wanted = self.paths.follow(self.gate.command, clock, position, speed, lead)
        return None if wanted is None else round(wanted / VELOCITY_UNIT)

    def _check_watchdog(self, clock: int) -> None:
        """Disarm after the watchdog time without a command."""
        if self.armed and clock - self.gate.arrival > self.gate.watchdog:
            self.armed, self.watchdog_tripped = False, True

    def slow_field(self, sequence: int, fields: Sequence[Slow]) -> Slow:
        """Return the slow field of a frame: they take turns; every other is PATH on a path."""
        if not self.paths.report:
            return fields[sequence % len(fields)]
        return Slow.PATH if sequence % 2 else fields[sequence // 2 % len(fields)]

    def flags(self, referenced: bool) -> int:
        """Return the flags for telemetry."""
        return (
            State.ARMED * self.armed
            | State.STOPPED * self.stopped
            | State.WATCHDOG * self.watchdog_tripped
            | State.REFERENCED * referenced
            | State.FOLLOWING * self.paths.following
            | State.BROKEN * self.paths.broken
        )
