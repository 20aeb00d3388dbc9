"""State of the base's board, as a function of accepted commands and time.

All arithmetic is integer and exact in time: the result does not depend on how often it is polled.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Never

from fss_base_driver.protocol.frames import (
    BOARD,
    MAX_PULSE_AGE,
    TIME_UNIT,
    VALVES,
    BaseCommand,
    BaseCommandFlag,
    BaseSlow,
    BaseState,
    BaseTelemetry,
    Gripper,
    GripperFlag,
    decode,
)
from fss_link.protocol import Gate, Language

BOARD_LANGUAGE = Language[BaseCommand, Never](BaseCommand, None, decode, 500_000)
PERCENT = 100
_MASK = 0xFFFFFFFF


def board_gate(boot: int, key: bytes | None = None) -> Gate[BaseCommand, Never]:
    """Return the gate for the board's commands; `boot` identifies the board's start, 1 to 65535."""
    return Gate(BOARD, boot, BOARD_LANGUAGE, key)


@dataclass(frozen=True)
class Limits:
    """Limits of the board, which no frame changes."""

    longest: int = 1_000_000  # longest pulse [us]
    allowance: int = 5_000_000  # allowance of open time of a valve, full at the start [us]
    duty: int = 50  # rate at which the allowance refills [%]
    total: int = 300_000_000  # total open time of all valves since the last disarm command [us]


class Measured(NamedTuple):
    """Readings of the board's instruments."""

    gyro_sum: int = 0  # [counts]
    gyro_samples: int = 0
    closed: bool = False  # the gripper is closed
    holds: bool = False
    slow: Mapping[BaseSlow, int] = {}  # the fields that the board does not count itself


class BoardState:
    """State of the board: armed or not, latches, and open valves.

    Times are those of the board's clock [us], which never runs backwards.

    Args:
        gate: for the commands.
        limits: of the valves.
    """

    def __init__(self, gate: Gate[BaseCommand, Never], limits: Limits | None = None) -> None:
        self.gate, self.limits = gate, limits or Limits()
        self.armed = self.stopped = self.watchdog_tripped = self.limited = self.spent = False
        self.pulse = 0  # number of the last started pulse
        self.gripper = Gripper.KEEP  # last command to the gripper
        self.left = self.limits.total  # rest of the valves' total time [us]
        self.opened = [0] * VALVES  # total open time of each since the start [us]
        self._pulse_start = 0  # start of the last pulse
        self._clock = 0
        self._until = [0] * VALVES  # end of each valve's open time
        self._allowance = [PERCENT * self.limits.allowance] * VALVES  # [us / PERCENT]

    def receive(self, data: bytes, clock: int) -> bool:
        """Process received bytes; return True if they were accepted as a command."""
        self.tick(clock)
        command = self.gate.accept(data, clock)
        if not isinstance(command, BaseCommand):
            return False
        if command.flags & BaseCommandFlag.STOP:
            self.stopped = True
            self._disarm()
        elif not command.flags & BaseCommandFlag.ARM:
            self.stopped = self.watchdog_tripped = self.limited = self.spent = False
            self.left = self.limits.total
            self._disarm()
        elif not (self.stopped or self.watchdog_tripped or self.spent):
            self.armed = True
            self._obey(command)
        return True

    def tick(self, clock: int) -> None:
        """Advance the state to a time."""
        while self._clock < clock:
            self._pass(min(clock, self._next()))
            self._limit()

    def valves(self) -> int:
        """Return the open valves: bit i is valve i + 1."""
        return sum(1 << i for i in self._open())

    @property
    def until(self) -> tuple[int, ...]:
        """Planned closing time of each valve; 0 or a past time: closed."""
        return tuple(self._until)

    def remaining(self) -> list[int]:
        """Return the remaining planned open time of each valve [us]."""
        return [max(0, until - self._clock) for until in self._until]

    def flags(self) -> int:
        """Return the flags for telemetry."""
        return (
            BaseState.ARMED * self.armed
            | BaseState.STOPPED * self.stopped
            | BaseState.WATCHDOG * self.watchdog_tripped
            | BaseState.LIMITED * self.limited
            | BaseState.SPENT * self.spent
        )

    def telemetry(self, clock: int, sequence: int, measured: Measured) -> BaseTelemetry:
        """Return the telemetry frame with that sequence number, measured now."""
        self.tick(clock)
        gate, command = self.gate, self.gate.command
        slow = list(BaseSlow)[sequence % len(BaseSlow)]
        closes = self.gripper is Gripper.CLOSE
        age = (clock - self._pulse_start) // TIME_UNIT if self.pulse else MAX_PULSE_AGE
        return BaseTelemetry(
            link=gate.number,
            flags=self.flags(),
            boot=gate.boot,
            sequence=sequence & _MASK,
            clock=clock,
            echo=command.clock & _MASK if command else 0,
            turnaround=min(clock - gate.arrival, _MASK) if command else 0,
            gyro_sum=measured.gyro_sum & _MASK,
            gyro_samples=measured.gyro_samples & 0xFFFF,
            valves=self.valves(),
            gripper=GripperFlag.COMMANDED_CLOSED * closes
            | GripperFlag.CLOSED * measured.closed
            | GripperFlag.HOLDS * measured.holds,
            pulse=self.pulse,
            pulse_age=min(age, MAX_PULSE_AGE),
            slow_id=slow,
            slow_value=_signed(self._slow_value(slow, measured)),
        )

    def _slow_value(self, slow: BaseSlow, measured: Measured) -> int:
        if slow >= BaseSlow.OPEN_1:
            return self.opened[slow - BaseSlow.OPEN_1] // 1000
        if slow is BaseSlow.LEFT:
            return self.left // 1000
        if slow is BaseSlow.REFUSED:
            return self.gate.refused.total()
        return measured.slow.get(slow, 0)

    def _obey(self, command: BaseCommand) -> None:
        """Execute a command that arms."""
        if command.gripper != Gripper.KEEP:
            self.gripper = Gripper(command.gripper)
        if not command.pulse:
            self._close()
        elif command.pulse != self.pulse:
            self.pulse, self._pulse_start = command.pulse, self._clock
            times = [TIME_UNIT * time for time in command.on_times]
            self.limited |= max(times) > self.limits.longest
            self._until = [self._clock + min(time, self.limits.longest) for time in times]
            self._limit()

    def _disarm(self) -> None:
        self.armed = False
        self._close()

    def _close(self) -> None:
        self._until = [0] * VALVES

    def _open(self) -> list[int]:
        return [i for i, until in enumerate(self._until) if until > self._clock]

    def _next(self) -> int:
        """Return the earliest time of a change without a command; always later than now."""
        command, valves = self.gate.command, self._open()
        if not (self.armed and command):
            return 1 << 64
        times = [self.gate.arrival + self.gate.watchdog]
        if valves:
            drain = max(PERCENT - self.limits.duty, 1)
            times += [self._until[i] - 1 for i in valves]
            times += [self._clock + (self._allowance[i] - 1) // drain for i in valves]
            times += [command.expiry, self._clock + (self.left - 1) // len(valves)]
        return max(min(times), self._clock) + 1

    def _pass(self, clock: int) -> None:
        """Advance the time over an interval without changes."""
        passed, valves = clock - self._clock, self._open()
        full = PERCENT * self.limits.allowance
        for i, allowance in enumerate(self._allowance):
            gain = self.limits.duty * passed
            if i in valves:
                self.opened[i] += passed
                gain -= PERCENT * passed
            self._allowance[i] = min(allowance + gain, full)
        self.left = max(0, self.left - passed * len(valves))
        self._clock = clock

    def _limit(self) -> None:
        """Close the valves that must not be open any longer, and disarm if a limit requires it."""
        command, gate = self.gate.command, self.gate
        if not (self.armed and command):
            return
        if self._clock - gate.arrival > gate.watchdog:
            self.watchdog_tripped = True
            self._disarm()
        elif not self.left:
            self.spent = True
            self._disarm()
        elif self._clock > command.expiry:
            self._close()
        for i in self._open():
            if self._allowance[i] <= 0:
                self._until[i], self.limited = 0, True


def _signed(value: int) -> int:
    """Return the value as 32 bits, two's complement."""
    return ((value & _MASK) ^ 1 << 31) - (1 << 31)
