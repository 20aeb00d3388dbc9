"""A link's servo drive, emulated: its supply, its reference, and how it protects itself.

How it turns the joint is plant/drives.py; this is what it reports, and when it lets the joint go:
its status word and its latched faults (docs/reference/faults.md), by what happens to it in the
simulation or is injected. A latched fault keeps the motor off until it is cleared, which takes that
its cause is gone; those of the drive's own memory and logic end with its power alone.

The encoder is incremental: the position counts from where the power came. Homing goes to where a
flag on the joint ends, which covers the upper half of its turn, and counts from there.
"""

from math import copysign, pi, sqrt
from typing import NamedTuple

from fss_arm_model.description import Link
from fss_sim.faults import NO_DRIVE_FAULTS, DriveFaults
from fss_sim.link.instruments import Encoder
from fss_sim.link.power import AMBIENT, VOLTS, Load
from fss_sim.plant.plant import Demand, Motion

# Modes of a demand.
OFF, CURRENT, VELOCITY, POSITION = 0, 1, 11, 21
OFF_NOW = Demand(OFF)

# Bits of the status word that say how things are, docs/reference/faults.md.
CURRENT_LIMITED, VOLTAGE_LIMITED = 1 << 7, 1 << 8
AT_POSITIVE_SWITCH, AT_NEGATIVE_SWITCH = 1 << 9, 1 << 10
ENABLE_OPEN, IS_OFF, STOPPING = 1 << 11, 1 << 12 | 1 << 14 | 1 << 15, 1 << 13
AT_HIGHEST, AT_LOWEST, LAGS, WAS_RESET, WRAPPED = 1 << 16, 1 << 17, 1 << 19, 1 << 20, 1 << 21
LATCHED, FLAG, IN_MOTION = 1 << 22, 1 << 26, 1 << 27


class Cause(NamedTuple):
    """What the drive protects itself from: bits of its status meanwhile, and what it latches."""

    status: int
    latch: int


SHORT, TOO_HIGH, TOO_LOW = Cause(1 << 0, 1 << 2), Cause(1 << 2, 1 << 5), Cause(1 << 3, 1 << 6)
DRIVE_HOT, MOTOR_HOT = Cause(1 << 1, 1 << 3), Cause(1 << 4, 1 << 4)
FEEDBACK, PHASING, TRACKING = Cause(1 << 5, 1 << 7), Cause(1 << 6, 1 << 8), Cause(1 << 18, 1 << 9)
OVERCURRENT, INPUT_LOST = Cause(0, 1 << 10), Cause(0, 1 << 12)
FLASH, INTERNAL, LOGIC = Cause(0, 1 << 0), Cause(0, 1 << 1), Cause(0, 1 << 11)
FOR_GOOD = FLASH.latch | INTERNAL.latch | LOGIC.latch  # no clearing helps
#: What faults that are on or off do.
INJECTED = {
    "short_circuit": SHORT, "overcurrent": OVERCURRENT, "encoder": FEEDBACK, "phasing": PHASING,
    "flash": FLASH, "internal": INTERNAL, "logic": LOGIC, "command_input": INPUT_LOST,
    "positive_limit": Cause(AT_POSITIVE_SWITCH, 0), "negative_limit": Cause(AT_NEGATIVE_SWITCH, 0),
    "enable": Cause(ENABLE_OPEN, 0), "voltage_limit": Cause(VOLTAGE_LIMITED, 0),
    "wrapped": Cause(WRAPPED, 0),
}  # fmt: skip
BLOCKING = 0x7F | ENABLE_OPEN | TRACKING.status | LATCHED  # of the status: no motion

# All of these are assumed; the motor's warmth is such that its continuous current, for 0.75 N m and
# what of 3.0 A for 1.8 N m friction takes (docs/start/hardware.md), heats it to its limit.
HIGHEST, LOWEST, DEAD = 55.0, 20.0, 12.0  # supply, and below which its logic loses power [V]
DRIVE_LIMIT, DRIVE_WARMTH, DRIVE_COOLING = 70.0, 6.0, 200.0  # [deg C], [K] when idle, [s]
DRIVE_LOSS = 2.0  # [K/A^2]
MOTOR_LIMIT, MOTOR_COOLING, CONTINUOUS = 100.0, 300.0, 1.6  # [deg C], [s], [A]
HYSTERESIS = 5.0  # of both limits [K]
MOTOR_WARMTH = (MOTOR_LIMIT - AMBIENT) / CONTINUOUS**2  # [K/A^2]
LAG, WARNED_LAG = 0.2, 0.1  # behind the profile [rad]
PUSH = 3000.0  # against what blocks the joint, by how far it is from where it shall be [A/rad]
REST = 1e-3  # a slower joint is at rest [rad/s]
HOMING_SPEED, HOMING_ACCELERATION = 0.2, 1.0  # [rad/s], [rad/s^2]


class ServoDrive:
    """The servo drive of one link, with power and referenced at the begin.

    Args:
        link: its description.
        encoder: of its motor.
    """

    def __init__(self, link: Link, encoder: Encoder) -> None:
        self._link, self._encoder = link, encoder
        self.count = link.drive.direction * 2.0 * pi / link.drive.counts_per_turn  # [rad]
        self.powered, self.referenced, self.homings = True, True, 0  # since its power came
        self.latched = 0  # its variable 0xa4
        self._drive_rise, self._motor_rise = DRIVE_WARMTH, 0.0  # above AMBIENT [K]
        self.supply = VOLTS  # [V]
        self.demand = OFF_NOW  # what it does
        self._zero = 0.0  # encoder's angle that it counts from [rad]
        self._frozen: float | None = None  # its angle while it does not come through [rad]
        self._wrong = 0  # bits of the status, of what is wrong or limited
        self._was_reset = 0
        self._faults, self._injected = NO_DRIVE_FAULTS, Cause(0, 0)
        self._order: Demand | None = self.demand  # the last one, as `act` has it
        self._above: bool | None = None  # where its search for the reference began
        self._speed = self._lag = 0.0  # of its profile [rad/s], and behind it [rad]

    @property
    def able(self) -> bool:
        """Whether it has power, and nothing that blocks motion."""
        return self.powered and not self._wrong & BLOCKING and not self.latched

    @property
    def blocked(self) -> bool:
        """Whether something holds the joint."""
        return self._faults.blocked > 0.0

    @property
    def temperature(self) -> float:
        """Of the drive [deg C]."""
        return AMBIENT + self._drive_rise + self._faults.drive_heat

    @property
    def motor_temperature(self) -> float:
        """Of the motor's winding [deg C]."""
        return AMBIENT + self._motor_rise + self._faults.motor_heat

    def reading(self, q: float) -> float:
        """The angle that it reads [rad]."""
        at = self._encoder.reading(q) if self._frozen is None else self._frozen
        return at - self._zero

    def rate(self, motion: Motion) -> float:
        """How fast that changes [rad/s]."""
        return self._encoder.rate(motion.q, motion.qd) if self._frozen is None else 0.0

    def angle(self, reading: float) -> float:
        """The joint's angle at which this is read [rad]."""
        return self._encoder.angle(reading + self._zero)

    def status(self, motion: Motion) -> int:
        """Its variable 0xa0."""
        off = self.demand.mode == OFF
        moves = abs(motion.qd) >= REST
        brakes = self.demand.mode == POSITION and self.demand.speed == 0.0
        return (
            self._wrong
            | self._was_reset
            | IS_OFF * off
            | STOPPING * (moves and brakes)
            | AT_HIGHEST * (motion.q >= self._link.q_max)
            | AT_LOWEST * (motion.q <= self._link.q_min)
            | LATCHED * bool(self.latched)
            | FLAG * (motion.q >= 0.0)
            | IN_MOTION * moves
        )

    def home(self) -> None:
        """Begin to look for the reference, which is not known until it is found."""
        self.referenced, self._above = False, None

    def clear(self) -> None:
        """Forget the latched faults whose cause is gone."""
        self.latched &= FOR_GOOD

    def act(self, demand: Demand | None, motion: Motion) -> Demand:
        """What the motor is to do of a demand from now on; None: the drive homes."""
        self._order = demand
        if not self.able:
            demand = OFF_NOW
        elif demand is None:
            demand = self._home(motion)
        if demand.mode == OFF or demand.mode != self.demand.mode:
            self._speed, self._lag = motion.qd, 0.0
        self.demand = demand
        return demand

    def effort(self, motion: Motion) -> Demand:
        """What the joint is exposed to by the drive and by whoever touches it."""
        faults, drive, (mode, goal, speed, _) = self._faults, self._link.drive, self.demand
        if mode == OFF:
            return Demand(CURRENT, faults.hand / drive.torque_constant) if faults.hand else OFF_NOW
        way = goal - motion.q if mode == POSITION else goal
        way = 0.0 if mode == POSITION and not speed else way
        barred = AT_POSITIVE_SWITCH if way > 0.0 else AT_NEGATIVE_SWITCH
        if way and self._wrong & barred:  # it goes no further
            return Demand(POSITION, 0.0, 0.0, drive.max_acceleration)
        if self.blocked and mode != CURRENT:  # it does what it can
            return Demand(CURRENT, max(-drive.max_current, min(PUSH * way, drive.max_current)))
        return self.demand

    def go_on(self, motion: Motion) -> Demand:
        """What the motor is to do as nobody tells the drive anything."""
        return self.act(self._order, motion)

    def _home(self, motion: Motion) -> Demand:
        """Go to the flag's end, and there once it is found."""
        above = motion.q >= 0.0
        if self.referenced:
            return Demand(POSITION, self.angle(0.0), HOMING_SPEED, HOMING_ACCELERATION)
        if self._above is None:
            self._above = above
        if above != self._above:  # the drive's input catches the count at the edge itself
            self._zero, self.referenced, self.homings = 0.0, True, self.homings + 1
        speed = -HOMING_SPEED if self._above else HOMING_SPEED
        return Demand(VELOCITY, speed, HOMING_SPEED, HOMING_ACCELERATION)

    def load(self, motion: Motion) -> Load:
        """What it takes from its supply."""
        mechanical = self._link.drive.torque_constant * motion.current * motion.qd
        return Load(self.demand.mode != OFF, motion.current, mechanical)

    def advance(
        self,
        seconds: float,
        motion: Motion,
        supply: float = VOLTS,
        faults: DriveFaults = NO_DRIVE_FAULTS,
    ) -> None:
        """Let a time pass [s] with the motion and the supply [V] that it had."""
        self.supply = max(0.0, supply + faults.supply)
        square = motion.current * motion.current
        self._motor_rise += (MOTOR_WARMTH * square - self._motor_rise) * seconds / MOTOR_COOLING
        steady = DRIVE_WARMTH + DRIVE_LOSS * square
        self._drive_rise += (steady - self._drive_rise) * seconds / DRIVE_COOLING
        if faults is not self._faults:
            self._inject(faults)
        if self.supply < DEAD:
            self._lose_power()
            return
        if not self.powered:
            self._gain_power(motion)
        self._follow(seconds, motion)
        if (faults.encoder > 0.0) != (self._frozen is not None):
            self._freeze(motion)
        self._judge(motion)

    def _inject(self, faults: DriveFaults) -> None:
        """Have other faults from now on."""
        causes = [cause for name, cause in INJECTED.items() if getattr(faults, name) > 0.0]
        status, latch = (sum(column) for column in zip(Cause(0, 0), *causes, strict=True))
        self._faults, self._injected = faults, Cause(status, latch)

    def _follow(self, seconds: float, motion: Motion) -> None:
        """See how far the joint lags behind its profile: at the motor's limit, in position mode."""
        mode, goal, speed, acceleration = self.demand
        is_limited = abs(motion.current) >= 0.999 * self._link.drive.max_current
        if mode != POSITION or not is_limited:
            self._speed, self._lag = motion.qd, 0.0
            return
        way = goal - motion.q
        wanted = copysign(min(speed, sqrt(2.0 * acceleration * abs(way))), way) if speed else 0.0
        most = acceleration * seconds
        self._speed += max(-most, min(wanted - self._speed, most))
        self._lag += (self._speed - motion.qd) * seconds

    def _judge(self, motion: Motion) -> None:
        """Find what is wrong, and latch what is to be."""
        wrong, latch = self._injected
        if abs(motion.current) >= 0.999 * self._link.drive.max_current:
            wrong |= CURRENT_LIMITED
        if abs(self._lag) > WARNED_LAG:
            wrong |= LAGS
        for cause, holds in (
            (TOO_LOW, self.supply < LOWEST),
            (TOO_HIGH, self.supply > HIGHEST),
            (DRIVE_HOT, self.temperature > DRIVE_LIMIT - self._cooling(DRIVE_HOT)),
            (MOTOR_HOT, self.motor_temperature > MOTOR_LIMIT - self._cooling(MOTOR_HOT)),
            (TRACKING, abs(self._lag) > LAG or self.latched & TRACKING.latch),
        ):
            if holds:
                wrong, latch = wrong | cause.status, latch | cause.latch
        self._wrong, self.latched = wrong, self.latched | latch

    def _cooling(self, cause: Cause) -> float:
        """By how much below its limit what was too hot is so no more [K]."""
        return HYSTERESIS if self._wrong & cause.status else 0.0

    def _freeze(self, motion: Motion) -> None:
        """Lose the encoder, or have it again, without what it counted meanwhile."""
        if self._frozen is None:
            self._frozen, self.referenced = self._encoder.reading(motion.q), False
        else:
            self._zero += self._encoder.reading(motion.q) - self._frozen
            self._frozen = None

    def _lose_power(self) -> None:
        """Forget all."""
        self.powered = self.referenced = False
        self.latched = self._wrong = 0
        self._frozen, self.demand = None, OFF_NOW

    def _gain_power(self, motion: Motion) -> None:
        """Begin to count."""
        self.powered, self._was_reset = True, WAS_RESET
        self._zero, self.homings = self._encoder.reading(motion.q), 0
