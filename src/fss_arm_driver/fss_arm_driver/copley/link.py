"""Link made of a Copley drive alone, without the link's electronics: frames in, frames out."""

from collections import deque

from fss_arm_driver.copley.drive import Demand, Drive, DriveGoal
from fss_arm_driver.copley.language import Variable
from fss_arm_driver.faults import blocking_faults
from fss_arm_driver.protocol import (
    NO_TORQUE,
    Command,
    Goal,
    LinkCommandFlag,
    LinkState,
    Mode,
    Slow,
    Telemetry,
    encode,
    link_gate,
)

PERIOD = 200_000  # of telemetry [us]
LEAD = 10_000  # half the time a velocity is applied, plus the time to set it [us]
MAX_ACCEPTED = 1024  # commands remembered: at least those of one round of readings
SLOW_FIELDS = {
    Slow.FAULTS: Variable.FAULTS,
    Slow.SUPPLY: Variable.SUPPLY,
    Slow.TEMPERATURE: Variable.TEMPERATURE,
}
FIELDS = (*SLOW_FIELDS, Slow.HOMINGS, Slow.REFUSED, Slow.PATH, Slow.SERIAL)
GOALS = {
    Mode.OFF: DriveGoal.RELEASE,
    Mode.CURRENT: DriveGoal.CURRENT,
    Mode.VELOCITY: DriveGoal.VELOCITY,
    Mode.POSITION: DriveGoal.POSITION,
}


class DriveLink:
    """Link that executes commands with the drive, and makes telemetry (docs/reference/protocol.md).

    Args:
        number: of the link.
        boot: number of this start, 1 to 65535.
        key: key that signs the frames, if any.
        baud: working rate.
    """

    def __init__(self, number: int, boot: int, key: bytes | None, baud: int) -> None:
        self.state = LinkState(link_gate(number, boot, key))
        self._baud = baud
        self._speed: int | None = None  # velocity on a path, from the last position
        self.drive = Drive(baud, self._steer)
        self._periods = 0
        self._sequence, self._measured = 0, 0
        self._accepted: deque[tuple[int, int]] = deque(maxlen=MAX_ACCEPTED)  # arrivals and clocks

    def restart(self) -> None:
        """Reset the drive's state, which is unknown after the line was reopened."""
        homings = self.drive.homings
        self.drive = Drive(self._baud, self._steer)
        self.drive.homings = homings

    def receive(self, data: bytes, clock: int) -> None:
        """Accept or refuse a command, or a segment of a path."""
        if self.state.receive(data, clock):
            command = self.state.gate.command
            assert command
            self._accepted.append((clock, command.clock))
            if command.flags & LinkCommandFlag.CLEAR_FAULTS:
                self.drive.clear_faults = True

    def poll(self, data: bytes, clock: int) -> tuple[bytes, bytes]:
        """Process bytes from the drive; return bytes for it, and a telemetry frame if due."""
        reading = self.drive.reading
        if reading is None or blocking_faults(reading.status, 0) or self.drive.switched_off:
            self.state.drop()
        self.drive.demand = self._demand(clock)
        out = self.drive.poll(data, clock)
        return out, self._telemetry(clock)

    def _demand(self, clock: int) -> Demand:
        goal, command = self.state.goal(clock), self.state.gate.command
        if goal is Goal.RELEASE or command is None:
            return Demand()
        if goal is Goal.FOLLOW and self._speed is not None:
            return Demand(DriveGoal.FOLLOW, acceleration=command.acceleration)
        return _commanded(command) if goal is Goal.OBEY else Demand(DriveGoal.HOLD)

    def _steer(self, position: int, clock: int, velocity: int) -> int | None:
        """Return the velocity on the commanded path, if any, from the joint's position."""
        follows = self.state.goal(clock) is Goal.FOLLOW
        self._speed = self.state.velocity(clock, position, velocity, LEAD) if follows else None
        return self._speed

    def _telemetry(self, clock: int) -> bytes:
        reading, gate = self.drive.reading, self.state.gate
        if reading is None or reading.clock == self._measured:
            return b""
        if reading.clock // PERIOD == self._periods:
            return b""
        self._measured, self._periods = reading.clock, reading.clock // PERIOD
        arrival, echo = self._last_accepted(reading.clock)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        slow = self.state.slow_field(self._sequence, FIELDS)
        known = reading.mode in GOALS
        frame = Telemetry(
            link=gate.number,
            flags=self.state.flags(self.drive.referenced),
            boot=gate.boot,
            sequence=self._sequence,
            clock=reading.clock,
            echo=echo & 0xFFFFFFFF,
            turnaround=min(reading.clock - arrival, 0xFFFFFFFF),
            position=_signed(reading.position, 32),
            velocity=_signed(reading.velocity, 32),
            current=_signed(reading.current, 16),
            mode=reading.mode if known else Mode.OFF,
            slow_id=slow,
            status=reading.status,
            torque=0,
            torque_age=NO_TORQUE,  # there is no torque converter
            slow_value=_signed(self._slow_value(slow), 32),
        )
        return encode(frame, gate.key)

    def _last_accepted(self, clock: int) -> tuple[int, int]:
        """Return arrival and clock of the last command accepted until `clock`."""
        while len(self._accepted) > 1 and self._accepted[1][0] <= clock:
            self._accepted.popleft()
        return self._accepted[0] if self._accepted and self._accepted[0][0] <= clock else (clock, 0)

    def _slow_value(self, slow: Slow) -> int:
        if slow in SLOW_FIELDS:
            return self.drive.slow[SLOW_FIELDS[slow]]
        if slow is Slow.PATH:
            return self.state.paths.report
        if slow is Slow.SERIAL:
            return 0
        return self.drive.homings if slow is Slow.HOMINGS else self.state.gate.refused.total()


def _commanded(command: Command) -> Demand:
    if command.flags & LinkCommandFlag.HOME:
        return Demand(DriveGoal.HOME)
    if command.mode == Mode.POSITION:
        return Demand(DriveGoal.POSITION, command.set_point, command.velocity, command.acceleration)
    acceleration = command.acceleration if command.mode == Mode.VELOCITY else 0
    return Demand(GOALS[Mode(command.mode)], command.set_point, 0, acceleration)


def _signed(value: int, bits: int) -> int:
    """Clamp `value` to the range of a signed integer of `bits` bits."""
    limit = 1 << bits - 1
    return max(-limit, min(value, limit - 1))
