"""Emulated electronics of one link: the link's side of docs/reference/protocol.md, in bytes.

This is the behaviour of the firmware, in its own units: the link's clock in microseconds since its
start, counts of the servo drive, counts of the torque converter.
"""

from dataclasses import replace

from fss_arm_driver.protocol import (
    ACCELERATION_UNIT,
    CURRENT_UNIT,
    VELOCITY_UNIT,
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
from fss_arm_model.description import Link
from fss_sim.link.instruments import Instruments, make_instruments
from fss_sim.link.power import Battery
from fss_sim.link.servo import REST_SPEED, ServoDrive
from fss_sim.plant.vehicle import Demand, Motion

RELEASE_TIMEOUT = 3_000_000  # a joint to be released is released by then even if it moves [us]

VELOCITY_LEAD = 5000  # half the time for which a demand is valid [us]

FIRMWARE = 0x020100  # 2.1.0


class LinkElectronics(LinkState):
    """Electronics of one link, from their start.

    The owner calls `receive` for each datagram, `demand` before the joint moves and `telemetry`
    afterwards. The clock in these calls must never decrease.

    Args:
        number: number of the link; 1 is next to the base.
        link: description of the link.
        boot: boot number of this start, 1 to 65535.
        rate: telemetry rate [frames/s].
        key: key that signs the frames, if any.
        instruments: instruments of the link; without errors by default.
        drive: servo drive, whose state is kept; a new one by default.
        battery: battery whose voltage is measured; a full one by default.
    """

    def __init__(
        self,
        number: int,
        link: Link,
        boot: int,
        rate: float = 5.0,
        key: bytes | None = None,
        instruments: Instruments | None = None,
        drive: ServoDrive | None = None,
        battery: Battery | None = None,
    ) -> None:
        super().__init__(link_gate(number, boot, key))
        self.link = link
        self.instruments = instruments or make_instruments(link.torque_sensor)
        self.drive = drive or ServoDrive(link, self.instruments.encoder)
        self._was_referenced = self.drive.referenced
        self.homings = int(self._was_referenced)  # number of times that the drive became referenced
        self._homing = self._clearing = False
        self._battery = battery or Battery()
        self._demand = self.drive.demand
        self._last_hold = 0  # last time at which the joint was not to be released [us]
        self._acceleration = link.drive.max_acceleration
        self._period = round(1e6 / rate)  # [us]
        self._last_period = -1  # periods of the clock until the last frame
        self._sequence = 0  # of the next frame

    def receive(self, data: bytes, clock: int) -> bool:
        """Accept or reject a received datagram; return True if it was accepted."""
        accepted, command = super().receive(data, clock), self.gate.command
        if accepted and command:
            flags = command.flags
            self._clearing |= bool(flags & LinkCommandFlag.CLEAR_FAULTS and self.drive.latched)
            homing, self._homing = self._homing, bool(self.armed and flags & LinkCommandFlag.HOME)
            if self._homing and not homing:
                self.drive.home()
        return accepted

    def demand(self, clock: int, motion: Motion) -> Demand:
        """Give the servo drive its demand from now on; return what the drive does."""
        if not self.drive.can_move:
            self.drop()
        goal, command = self.goal(clock), self.gate.command
        self._homing = self._homing and goal is Goal.OBEY
        if goal is not Goal.RELEASE:
            self._last_hold = clock
        if goal is Goal.FOLLOW and command:
            speed = self.velocity(clock, *self._encoder_reading(motion), VELOCITY_LEAD)
            turn = replace(command, mode=Mode.VELOCITY, set_point=speed or 0)
            self._demand = self._hold_demand() if speed is None else self._command_demand(turn)
        elif goal is Goal.OBEY and command and not self._homing:
            self._demand = self._command_demand(command)
        elif goal is not Goal.RELEASE:
            self._demand = self._hold_demand()
        elif self._demand.mode != Mode.OFF:
            released = abs(motion.qd) < REST_SPEED or clock - self._last_hold > RELEASE_TIMEOUT
            self._demand = Demand(Mode.OFF) if released else self._hold_demand()
        executed = self.drive.execute(None if self._homing else self._demand, motion)
        if executed.mode == Mode.OFF:
            self._demand = executed
            if self._clearing:  # only while off: a drive that is on would resume its motion
                self._clearing = False
                self.drive.clear()
        self._count_homings()
        return executed

    def _count_homings(self) -> None:
        """Count the times that the drive becomes referenced."""
        self.homings += self.drive.referenced and not self._was_referenced
        self._was_referenced = self.drive.referenced

    def telemetry(self, clock: int, motion: Motion) -> bytes | None:
        """Return the frame that is due now; None between frames, or if the drive has no power."""
        torque = self.instruments.torque
        torque.sample(clock, motion.torque, motion.shear)
        if clock // self._period == self._last_period or not self.drive.powered:
            return None
        self._count_homings()
        self._last_period = clock // self._period
        sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFFFFFFFF
        slow = self.slow_field(sequence, list(Slow))
        position, velocity = self._encoder_reading(motion)
        gate, command = self.gate, self.gate.command
        frame = Telemetry(
            link=gate.number,
            flags=self.flags(self.drive.referenced),
            boot=gate.boot,
            sequence=sequence,
            clock=clock,
            echo=command.clock & 0xFFFFFFFF if command else 0,
            turnaround=min(clock - gate.arrival, 0xFFFFFFFF) if command else 0,
            position=position,
            velocity=velocity,
            current=_signed(self.link.drive.direction * motion.current / CURRENT_UNIT, 16),
            mode=self._demand.mode,
            slow_id=slow,
            status=self.drive.status(motion),
            torque=torque.counts,
            torque_age=min(torque.age(clock) // 1000, 255),
            slow_value=self._slow_value(slow),
        )
        return encode(frame, gate.key)

    def _encoder_reading(self, motion: Motion) -> tuple[int, int]:
        """Return position [counts] and velocity [0.1 counts/s] as read by the encoder."""
        drive = self.drive
        return (
            _signed(drive.reading(motion.q) / drive.count, 32),
            _signed(drive.rate(motion) / (drive.count * VELOCITY_UNIT), 32),
        )

    def _hold_demand(self) -> Demand:
        """Return the demand to decelerate and hold; a drive that already holds does not move."""
        return Demand(Mode.POSITION, 0.0, 0.0, self.link.drive.max_acceleration)

    def _command_demand(self, command: Command) -> Demand:
        """Return the command in SI units, within the limits of the drive."""
        drive, count = self.link.drive, self.drive.count
        if command.mode in (Mode.VELOCITY, Mode.POSITION) and command.acceleration:
            requested = command.acceleration * ACCELERATION_UNIT * abs(count)
            self._acceleration = min(requested, drive.max_acceleration)
        speed = min(command.velocity * VELOCITY_UNIT * abs(count), drive.max_velocity)
        if command.mode == Mode.POSITION:
            set_point = self.drive.angle(command.set_point * count)
        elif command.mode == Mode.VELOCITY:
            set_point = command.set_point * VELOCITY_UNIT * count
            speed = min(abs(set_point), drive.max_velocity)
        else:
            set_point = command.set_point * CURRENT_UNIT * drive.direction
        return Demand(command.mode, set_point, speed, self._acceleration)

    def _slow_value(self, slow: Slow) -> int:
        return {
            Slow.FAULTS: self.drive.latched,
            Slow.SUPPLY: _signed(10.0 * self.drive.supply, 32),
            Slow.BATTERY: _signed(10.0 * self._battery.volts, 32),
            Slow.TEMPERATURE: _signed(self.drive.temperature, 32),
            Slow.FIRMWARE: FIRMWARE,
            Slow.HOMINGS: self.homings,
            Slow.REFUSED: _signed(self.gate.refused.total(), 32),
            Slow.PATH: self.paths.report,
            Slow.SERIAL: self.link.serial,
        }[slow]


def _signed(value: float, bits: int) -> int:
    """Return the nearest signed integer of `bits` bits."""
    limit = 1 << bits - 1
    return max(-limit, min(round(value), limit - 1))
