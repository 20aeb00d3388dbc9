"""One link's electronics, emulated: docs/protocol.md seen from the link. Bytes in, bytes out.

What the firmware does, in its own units: the link's clock in microseconds since its start, the
servo drive's counts, the torque converter's counts.
"""

from collections import Counter
from enum import Enum
from math import pi

from fss_arm_driver.protocol import (
    ACCELERATION_UNIT,
    CURRENT_UNIT,
    VELOCITY_UNIT,
    Command,
    FrameError,
    Mode,
    Order,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
    newer,
)
from fss_arm_model.description import Link
from fss_sim.plant import Demand, Motion

WATCHDOG = 2_000_000  # until a command says otherwise [us]
TORQUE_PERIOD = 12_500  # of the torque converter, 80 samples a second [us]
STILL = 1e-3  # a joint slower than this is at rest [rad/s]

# The servo drive's status word.
DISABLED, AT_HIGHEST, AT_LOWEST, IN_MOTION = 1 << 12, 1 << 16, 1 << 17, 1 << 27

SUPPLY, BATTERY, TEMPERATURE, FIRMWARE = 240, 148, 31, 0x010000  # 24.0 V, 14.8 V, deg C, 1.0.0


class Refused(Enum):
    """Why a datagram is not taken as a command."""

    FRAME = "not a frame"
    OTHER = "not a command to this link"
    BOOT = "for another start"
    SEQUENCE = "not newer than the last"
    EXPIRED = "expired"


class LinkElectronics:
    """The electronics of one link, from their start.

    The node that owns it calls `receive` for each datagram, `demand` before the joint moves on and
    `telemetry` after; the clock they are given never runs back.

    Args:
        number: of the link, 1 beside the base.
        link: its description.
        boot: which start this is, 1 to 65535.
        rate: of telemetry [frames/s].
    """

    def __init__(self, number: int, link: Link, boot: int, rate: float = 5.0) -> None:
        self.number, self.link, self.boot = number, link, boot
        self.refused: Counter[Refused] = Counter()
        self.armed = self.stopped = self.watchdog_tripped = False
        drive = link.drive
        self._count = drive.direction * 2.0 * pi / drive.counts_per_turn  # [rad]
        self._demand = Demand(Mode.OFF)
        self._acceleration = drive.max_acceleration
        self._command: Command | None = None  # the last one taken
        self._arrival = 0  # of that command [us]
        self._newest = 0  # sequence taken
        self._watchdog = WATCHDOG
        self._period = round(1e6 / rate)  # [us]
        self._periods = -1  # of the clock, at the last frame
        self._sequence = 0  # of the next frame
        self._torque_clock = -TORQUE_PERIOD
        self._torque = 0

    def receive(self, data: bytes, clock: int) -> bool:
        """Obey or refuse a datagram that has come; return whether it was taken."""
        try:
            command = decode(data)
        except FrameError:
            return self._refuse(Refused.FRAME)
        if not isinstance(command, Command) or command.link != self.number:
            return self._refuse(Refused.OTHER)
        stop, follows = command.flags & Order.STOP, self._follows(command, clock)
        if not stop and command.boot not in (0, self.boot):
            return self._refuse(Refused.BOOT)
        if not stop and not follows:
            return self._refuse(Refused.SEQUENCE)
        if command.expiry and command.expiry < clock:
            return self._refuse(Refused.EXPIRED)
        if follows:
            self._newest = command.sequence
        self._command, self._arrival, self._watchdog = command, clock, 1000 * command.watchdog
        self._obey(command)
        return True

    def demand(self, clock: int, motion: Motion) -> Demand:
        """What the servo drive is to do from now on."""
        command = self._command
        if command and self.armed:
            if clock - self._arrival > self._watchdog:
                self.armed, self.watchdog_tripped = False, True
                self._hold()
            elif command.expiry < clock:
                self._hold()
        released = not (self.armed or self.stopped or self.watchdog_tripped)
        if released and abs(motion.qd) < STILL:
            self._demand = Demand(Mode.OFF)
        return self._demand

    def telemetry(self, clock: int, motion: Motion) -> bytes | None:
        """The frame that is due now, measured now; None between frames."""
        if clock - self._torque_clock >= TORQUE_PERIOD:
            sensor = self.link.torque_sensor
            self._torque_clock = clock
            self._torque = _signed(motion.torque / sensor.gain + sensor.zero, 24)
        if clock // self._period == self._periods:
            return None
        self._periods = clock // self._period
        sequence, self._sequence = self._sequence, (self._sequence + 1) & 0xFFFFFFFF
        slow = list(Slow)[sequence % len(Slow)]
        command = self._command
        frame = Telemetry(
            link=self.number,
            flags=self._flags(),
            boot=self.boot,
            sequence=sequence,
            clock=clock,
            echo=command.clock & 0xFFFFFFFF if command else 0,
            turnaround=min(clock - self._arrival, 0xFFFFFFFF) if command else 0,
            position=_signed(motion.q / self._count, 32),
            velocity=_signed(motion.qd / self._count / VELOCITY_UNIT, 32),
            current=_signed(self.link.drive.direction * motion.current / CURRENT_UNIT, 16),
            mode=self._demand.mode,
            slow_id=slow,
            status=self._status(motion),
            torque=self._torque,
            torque_age=min((clock - self._torque_clock) // 1000, 255),
            slow_value=self._slow_value(slow),
        )
        return encode(frame)

    def _refuse(self, reason: Refused) -> bool:
        self.refused[reason] += 1
        return False

    def _follows(self, command: Command, clock: int) -> bool:
        """Whether it is newer than the last command, or may begin a session."""
        if self._command is None or clock - self._arrival > self._watchdog:
            return not command.flags & Order.ARM
        return newer(command.sequence, self._newest)

    def _obey(self, command: Command) -> None:
        if command.flags & Order.STOP:
            self.armed, self.stopped = False, True
            self._hold()
        elif not command.flags & Order.ARM:
            self.armed = self.stopped = self.watchdog_tripped = False
            self._hold()  # and off once at rest, by demand()
        elif not (self.stopped or self.watchdog_tripped):
            self.armed = True
            if command.flags & Order.HOLD:
                self._hold()
            else:
                self._demand = self._commanded(command)

    def _hold(self) -> None:
        """Decelerate and hold there; a drive that holds already goes on holding the same place."""
        self._demand = Demand(Mode.POSITION, 0.0, 0.0, self._acceleration)

    def _commanded(self, command: Command) -> Demand:
        """The command in SI units, within the drive's own limits."""
        drive, count = self.link.drive, abs(self._count)
        if command.mode in (Mode.VELOCITY, Mode.POSITION) and command.acceleration:
            asked = command.acceleration * ACCELERATION_UNIT * count
            self._acceleration = min(asked, drive.max_acceleration)
        speed = min(command.velocity * VELOCITY_UNIT * count, drive.max_velocity)
        if command.mode == Mode.POSITION:
            set_point = command.set_point * self._count
        elif command.mode == Mode.VELOCITY:
            set_point = command.set_point * VELOCITY_UNIT * self._count
            speed = min(abs(set_point), drive.max_velocity)
        else:
            set_point = command.set_point * CURRENT_UNIT * drive.direction
        return Demand(command.mode, set_point, speed, self._acceleration)

    def _flags(self) -> int:
        return (
            State.ARMED * self.armed
            | State.STOPPED * self.stopped
            | State.WATCHDOG * self.watchdog_tripped
            | State.REFERENCED
        )

    def _status(self, motion: Motion) -> int:
        return (
            DISABLED * (self._demand.mode == Mode.OFF)
            | AT_HIGHEST * (motion.q >= self.link.q_max)
            | AT_LOWEST * (motion.q <= self.link.q_min)
            | IN_MOTION * (abs(motion.qd) >= STILL)
        )

    def _slow_value(self, slow: Slow) -> int:
        return {
            Slow.FAULTS: 0,
            Slow.SUPPLY: SUPPLY,
            Slow.BATTERY: BATTERY,
            Slow.TEMPERATURE: TEMPERATURE,
            Slow.FIRMWARE: FIRMWARE,
            Slow.HOMINGS: 1,
            Slow.REFUSED: _signed(self.refused.total(), 32),
        }[slow]


def _signed(value: float, bits: int) -> int:
    """The nearest integer of so many bits."""
    limit = 1 << bits - 1
    return max(-limit, min(round(value), limit - 1))
