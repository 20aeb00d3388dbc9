"""One link's electronics, emulated: the link's side of docs/reference/protocol.md, in bytes.

What the firmware does, in its own units: the link's clock in microseconds since its start, the
servo drive's counts, the torque converter's counts.
"""

from dataclasses import replace
from math import pi

from fss_arm_driver.protocol import (
    ACCELERATION_UNIT,
    CURRENT_UNIT,
    VELOCITY_UNIT,
    Command,
    Gate,
    Goal,
    LinkState,
    Mode,
    Order,
    Slow,
    Telemetry,
    encode,
)
from fss_arm_model.description import Link
from fss_sim.link.instruments import Instruments, make
from fss_sim.plant.plant import Demand, Motion

MOTION_THRESHOLD = 1e-3  # a joint slower than this is at rest [rad/s]
RELEASE_TIMEOUT = 3_000_000  # with a joint that does not come to rest and shall be released [us]

LEAD = 5000  # half the time for which a demand stands [us]

# The servo drive's status word.
DISABLED, AT_HIGHEST, AT_LOWEST, IN_MOTION = 1 << 12, 1 << 16, 1 << 17, 1 << 27

SUPPLY, TEMPERATURE, FIRMWARE = 240, 31, 0x020000  # 24.0 V, deg C, 2.0.0


class LinkElectronics(LinkState):
    """The electronics of one link, from their start.

    The node that owns it calls `receive` for each datagram, `demand` before the joint moves on and
    `telemetry` after; the clock they are given never runs back.

    Args:
        number: of the link, 1 beside the base.
        link: its description.
        boot: which start this is, 1 to 65535.
        rate: of telemetry [frames/s].
        key: that frames are signed under, if any.
        instruments: without errors by default.
    """

    def __init__(
        self,
        number: int,
        link: Link,
        boot: int,
        rate: float = 5.0,
        key: bytes | None = None,
        instruments: Instruments | None = None,
    ) -> None:
        super().__init__(Gate(number, boot, key))
        self.link = link
        self.instruments = instruments or make(link.torque_sensor)
        self.referenced, self.homings, self._homing = True, 1, False
        drive = link.drive
        self._count = drive.direction * 2.0 * pi / drive.counts_per_turn  # [rad]
        self._demand = Demand(Mode.OFF)
        self._kept = 0  # when the joint was last not to be released [us]
        self._acceleration = drive.max_acceleration
        self._period = round(1e6 / rate)  # [us]
        self._periods = -1  # of the clock, at the last frame
        self._sequence = 0  # of the next frame

    def receive(self, data: bytes, clock: int) -> bool:
        """Obey or refuse a datagram that has come; return whether it was taken."""
        taken, command = super().receive(data, clock), self.gate.command
        if taken and command:
            homing, self._homing = self._homing, bool(self.armed and command.flags & Order.HOME)
            if self._homing and not homing:  # it finds it where it is
                self.referenced, self.homings = True, self.homings + 1
        return taken

    def demand(self, clock: int, motion: Motion) -> Demand:
        """What the servo drive is to do from now on."""
        goal, command = self.goal(clock), self.gate.command
        if goal is not Goal.RELEASE:
            self._kept = clock
        if goal is Goal.FOLLOW and command:
            speed = self.velocity(clock, *self._measured(motion), LEAD)
            turn = replace(command, mode=Mode.VELOCITY, set_point=speed or 0)
            self._demand = self._held() if speed is None else self._commanded(turn)
        elif goal is Goal.OBEY and command and not command.flags & Order.HOME:
            self._demand = self._commanded(command)
        elif goal is not Goal.RELEASE:
            self._demand = self._held()
        elif self._demand.mode != Mode.OFF:
            over = abs(motion.qd) < MOTION_THRESHOLD or clock - self._kept > RELEASE_TIMEOUT
            self._demand = Demand(Mode.OFF) if over else self._held()
        return self._demand

    def telemetry(self, clock: int, motion: Motion) -> bytes | None:
        """The frame that is due now, measured now; None between frames."""
        torque = self.instruments.torque
        torque.sample(clock, motion.torque, motion.shear)
        if clock // self._period == self._periods:
            return None
        self._periods = clock // self._period
        sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFFFFFFFF
        slow = self.slow_field(sequence, list(Slow))
        position, velocity = self._measured(motion)
        gate, command = self.gate, self.gate.command
        frame = Telemetry(
            link=gate.number,
            flags=self.flags(self.referenced),
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
            status=self._status(motion),
            torque=torque.counts,
            torque_age=min(torque.age(clock) // 1000, 255),
            slow_value=self._slow_value(slow),
        )
        return encode(frame, gate.key)

    def _measured(self, motion: Motion) -> tuple[int, int]:
        """Position [counts] and velocity [0.1 counts/s], as the encoder has them."""
        encoder, velocity = self.instruments.encoder, self._count * VELOCITY_UNIT
        return (
            _signed(encoder.reading(motion.q) / self._count, 32),
            _signed(encoder.rate(motion.q, motion.qd) / velocity, 32),
        )

    def _held(self) -> Demand:
        """Decelerate and hold there; a drive that holds already goes on holding the same place."""
        return Demand(Mode.POSITION, 0.0, 0.0, self.link.drive.max_acceleration)

    def _commanded(self, command: Command) -> Demand:
        """The command in SI units, within the drive's own limits."""
        drive, count = self.link.drive, abs(self._count)
        if command.mode in (Mode.VELOCITY, Mode.POSITION) and command.acceleration:
            asked = command.acceleration * ACCELERATION_UNIT * count
            self._acceleration = min(asked, drive.max_acceleration)
        speed = min(command.velocity * VELOCITY_UNIT * count, drive.max_velocity)
        if command.mode == Mode.POSITION:
            set_point = self.instruments.encoder.angle(command.set_point * self._count)
        elif command.mode == Mode.VELOCITY:
            set_point = command.set_point * VELOCITY_UNIT * self._count
            speed = min(abs(set_point), drive.max_velocity)
        else:
            set_point = command.set_point * CURRENT_UNIT * drive.direction
        return Demand(command.mode, set_point, speed, self._acceleration)

    def _status(self, motion: Motion) -> int:
        return (
            DISABLED * (self._demand.mode == Mode.OFF)
            | AT_HIGHEST * (motion.q >= self.link.q_max)
            | AT_LOWEST * (motion.q <= self.link.q_min)
            | IN_MOTION * (abs(motion.qd) >= MOTION_THRESHOLD)
        )

    def _slow_value(self, slow: Slow) -> int:
        return {
            Slow.FAULTS: 0,
            Slow.SUPPLY: SUPPLY,
            Slow.BATTERY: _signed(10.0 * self.instruments.battery.volts, 32),
            Slow.TEMPERATURE: TEMPERATURE,
            Slow.FIRMWARE: FIRMWARE,
            Slow.HOMINGS: self.homings,
            Slow.REFUSED: _signed(self.gate.refused.total(), 32),
            Slow.PATH: self.paths.report,
        }[slow]


def _signed(value: float, bits: int) -> int:
    """The nearest integer of so many bits."""
    limit = 1 << bits - 1
    return max(-limit, min(round(value), limit - 1))
