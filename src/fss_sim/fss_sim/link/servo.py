"""Emulated servo drive of a link: its supply, its reference, and its protection.

plant/drives.py computes the motion of the joint. This module determines what the drive reports, and
when it switches the motor off: its status word and its latched faults (docs/reference/faults.md).
They depend on the simulation and on injected faults. A latched fault keeps the motor off until it
is cleared. It can only be cleared after its cause is gone; faults of the drive's memory and logic
are only cleared by switching the power off.

The encoder is incremental: it counts from the position at which the power was switched on. A flag
on the joint covers the upper half of its turn. Homing moves to the end of this flag, and counts
from there.
"""

from math import copysign, pi, sqrt
from typing import NamedTuple

from fss_arm_model.description import Link
from fss_sim.faults import NO_DRIVE_FAULTS, DriveFaults
from fss_sim.link.instruments import Encoder
from fss_sim.link.power import AMBIENT, OUTPUT_VOLTAGE, Load
from fss_sim.plant.vehicle import Demand, Motion

# Modes of a demand.
MODE_OFF, MODE_CURRENT, MODE_VELOCITY, MODE_POSITION = 0, 1, 11, 21
DEMAND_OFF = Demand(MODE_OFF)

# Bits of the status word for states that are not faults, docs/reference/faults.md.
CURRENT_LIMITED, VOLTAGE_LIMITED = 1 << 7, 1 << 8
AT_POSITIVE_SWITCH, AT_NEGATIVE_SWITCH = 1 << 9, 1 << 10
ENABLE_OPEN, IS_OFF, STOPPING = 1 << 11, 1 << 12 | 1 << 14 | 1 << 15, 1 << 13
AT_MAX_POSITION, AT_MIN_POSITION = 1 << 16, 1 << 17
TRACKING_WARNING, WAS_RESET, WRAPPED = 1 << 19, 1 << 20, 1 << 21
LATCHED, FLAG, IN_MOTION = 1 << 22, 1 << 26, 1 << 27


class Cause(NamedTuple):
    """Cause of a protection: status bits while it is present, and faults that it latches."""

    status: int
    latch: int


SHORT_CIRCUIT = Cause(1 << 0, 1 << 2)
OVERVOLTAGE, UNDERVOLTAGE = Cause(1 << 2, 1 << 5), Cause(1 << 3, 1 << 6)
DRIVE_HOT, MOTOR_HOT = Cause(1 << 1, 1 << 3), Cause(1 << 4, 1 << 4)
FEEDBACK, PHASING, TRACKING = Cause(1 << 5, 1 << 7), Cause(1 << 6, 1 << 8), Cause(1 << 18, 1 << 9)
OVERCURRENT, INPUT_LOST = Cause(0, 1 << 10), Cause(0, 1 << 12)
FLASH, INTERNAL, LOGIC = Cause(0, 1 << 0), Cause(0, 1 << 1), Cause(0, 1 << 11)
PERMANENT = FLASH.latch | INTERNAL.latch | LOGIC.latch  # cannot be cleared by a command
#: Causes that injected faults of the on/off type trigger.
INJECTED = {
    "short_circuit": SHORT_CIRCUIT,
    "overcurrent": OVERCURRENT,
    "encoder": FEEDBACK,
    "phasing": PHASING,
    "flash": FLASH,
    "internal": INTERNAL,
    "logic": LOGIC,
    "command_input": INPUT_LOST,
    "positive_limit": Cause(AT_POSITIVE_SWITCH, 0),
    "negative_limit": Cause(AT_NEGATIVE_SWITCH, 0),
    "enable_open": Cause(ENABLE_OPEN, 0),
    "voltage_limit": Cause(VOLTAGE_LIMITED, 0),
    "wrapped": Cause(WRAPPED, 0),
}
BLOCKING = 0x7F | ENABLE_OPEN | TRACKING.status | LATCHED  # status bits that prevent motion

# All of these values are assumed. The motor's heating is chosen so that its continuous current
# heats it to its limit. This is the current for 0.75 N m plus friction. The friction follows from
# the peak values, 3.0 A for 1.8 N m (docs/start/hardware.md).
# Limits of the supply; below the last one, the logic loses power [V].
MAX_SUPPLY, MIN_SUPPLY, MIN_LOGIC_SUPPLY = 55.0, 20.0, 12.0
# [deg C], [K] when idle, [s].
MAX_DRIVE_TEMPERATURE, DRIVE_IDLE_RISE, DRIVE_TIME_CONSTANT = 70.0, 6.0, 200.0
DRIVE_HEATING = 2.0  # [K/A^2]
# [deg C], [s], [A].
MAX_MOTOR_TEMPERATURE, MOTOR_TIME_CONSTANT, CONTINUOUS_CURRENT = 100.0, 300.0, 1.6
HYSTERESIS = 5.0  # of both temperature limits [K]
MOTOR_HEATING = (MAX_MOTOR_TEMPERATURE - AMBIENT) / CONTINUOUS_CURRENT**2  # [K/A^2]
MAX_LAG, LAG_WARNING = 0.2, 0.1  # lags behind the profile that latch a fault, or warn [rad]
OBSTACLE_GAIN = 3000.0  # current against an obstacle, per position error [A/rad]
REST_SPEED = 1e-3  # speed below which a joint is at rest [rad/s]
HOMING_SPEED, HOMING_ACCELERATION = 0.2, 1.0  # [rad/s], [rad/s^2]


class ServoDrive:
    """Servo drive of one link, which is powered and referenced at the start.

    Args:
        link: description of the link.
        encoder: encoder of its motor.
    """

    def __init__(self, link: Link, encoder: Encoder) -> None:
        self._link, self._encoder = link, encoder
        self.count = link.drive.direction * 2.0 * pi / link.drive.counts_per_turn  # [rad]
        self.powered, self.referenced, self.homings = True, True, 0  # homings since power-on
        self.latched = 0  # latched faults, its variable 0xa4
        self._drive_rise, self._motor_rise = DRIVE_IDLE_RISE, 0.0  # above AMBIENT [K]
        self.supply = OUTPUT_VOLTAGE  # [V]
        self.demand = DEMAND_OFF  # demand in execution
        self._zero = 0.0  # encoder angle that it counts from [rad]
        self._frozen: float | None = None  # last encoder angle while the encoder is lost [rad]
        self._status_bits = 0  # status bits of present faults and limits
        self._was_reset = 0
        self._faults, self._injected = NO_DRIVE_FAULTS, Cause(0, 0)
        self._last_demand: Demand | None = self.demand  # last demand passed to `execute`
        self._homing_from_above: bool | None = None  # whether homing started above the flag's end
        self._speed = self._lag = 0.0  # speed of its profile [rad/s], lag behind it [rad]

    @property
    def can_move(self) -> bool:
        """Return True if the drive has power and no fault prevents motion."""
        return self.powered and not self._status_bits & BLOCKING and not self.latched

    @property
    def blocked(self) -> bool:
        """Return True if an obstacle blocks the joint."""
        return self._faults.blocked > 0.0

    @property
    def temperature(self) -> float:
        """Temperature of the drive [deg C]."""
        return AMBIENT + self._drive_rise + self._faults.drive_heat

    @property
    def motor_temperature(self) -> float:
        """Temperature of the motor's winding [deg C]."""
        return AMBIENT + self._motor_rise + self._faults.motor_heat

    def reading(self, q: float) -> float:
        """Return the drive's reading at the joint angle q [rad]."""
        at = self._encoder.reading(q) if self._frozen is None else self._frozen
        return at - self._zero

    def rate(self, motion: Motion) -> float:
        """Return the rate of the reading [rad/s]."""
        return self._encoder.rate(motion.q, motion.qd) if self._frozen is None else 0.0

    def angle(self, reading: float) -> float:
        """Return the joint angle that gives this reading [rad]."""
        return self._encoder.angle(reading + self._zero)

    def status(self, motion: Motion) -> int:
        """Return the status word, its variable 0xa0."""
        off = self.demand.mode == MODE_OFF
        moves = abs(motion.qd) >= REST_SPEED
        brakes = self.demand.mode == MODE_POSITION and self.demand.speed == 0.0
        return (
            self._status_bits
            | self._was_reset
            | IS_OFF * off
            | STOPPING * (moves and brakes)
            | AT_MAX_POSITION * (motion.q >= self._link.q_max)
            | AT_MIN_POSITION * (motion.q <= self._link.q_min)
            | LATCHED * bool(self.latched)
            | FLAG * (motion.q >= 0.0)
            | IN_MOTION * moves
        )

    def home(self) -> None:
        """Start homing; the reference is unknown until it is found."""
        self.referenced, self._homing_from_above = False, None

    def clear(self) -> None:
        """Clear the latched faults; those whose cause is still present are latched again."""
        self.latched &= PERMANENT

    def execute(self, demand: Demand | None, motion: Motion) -> Demand:
        """Return the demand that the motor executes from now on; None as argument: homing."""
        self._last_demand = demand
        if not self.can_move:
            demand = DEMAND_OFF
        elif demand is None:
            demand = self._homing_demand(motion)
        if demand.mode == MODE_OFF or demand.mode != self.demand.mode:
            self._speed, self._lag = motion.qd, 0.0
        self.demand = demand
        return demand

    def effective_demand(self, motion: Motion) -> Demand:
        """Return the demand that acts on the joint, with limit switches, obstacles and hands."""
        faults, drive, (mode, goal, speed, _) = self._faults, self._link.drive, self.demand
        if mode == MODE_OFF:
            hand = Demand(MODE_CURRENT, faults.hand / drive.torque_constant)
            return hand if faults.hand else DEMAND_OFF
        error = goal - motion.q if mode == MODE_POSITION else goal
        error = 0.0 if mode == MODE_POSITION and not speed else error
        blocked_by = AT_POSITIVE_SWITCH if error > 0.0 else AT_NEGATIVE_SWITCH
        if error and self._status_bits & blocked_by:  # a limit switch stops the motion
            return Demand(MODE_POSITION, 0.0, 0.0, drive.max_acceleration)
        if self.blocked and mode != MODE_CURRENT:  # the drive pushes against the obstacle
            current = max(-drive.max_current, min(OBSTACLE_GAIN * error, drive.max_current))
            return Demand(MODE_CURRENT, current)
        return self.demand

    def repeat_demand(self, motion: Motion) -> Demand:
        """Return the demand that the motor executes while the drive receives no commands."""
        return self.execute(self._last_demand, motion)

    def _homing_demand(self, motion: Motion) -> Demand:
        """Return the demand for homing: move to the flag's end, then hold there."""
        above = motion.q >= 0.0
        if self.referenced:
            return Demand(MODE_POSITION, self.angle(0.0), HOMING_SPEED, HOMING_ACCELERATION)
        if self._homing_from_above is None:
            self._homing_from_above = above
        # The drive's input latches the count exactly at the edge.
        if above != self._homing_from_above:
            self._zero, self.referenced, self.homings = 0.0, True, self.homings + 1
        speed = -HOMING_SPEED if self._homing_from_above else HOMING_SPEED
        return Demand(MODE_VELOCITY, speed, HOMING_SPEED, HOMING_ACCELERATION)

    def load(self, motion: Motion) -> Load:
        """Return the load on its supply."""
        mechanical = self._link.drive.torque_constant * motion.current * motion.qd
        return Load(self.demand.mode != MODE_OFF, motion.current, mechanical)

    def advance(
        self,
        seconds: float,
        motion: Motion,
        supply: float = OUTPUT_VOLTAGE,
        faults: DriveFaults = NO_DRIVE_FAULTS,
    ) -> None:
        """Advance by a time [s], with the motion and the supply [V] during that time."""
        self.supply = max(0.0, supply + faults.supply)
        square = motion.current * motion.current
        self._motor_rise += (
            (MOTOR_HEATING * square - self._motor_rise) * seconds / MOTOR_TIME_CONSTANT
        )
        steady = DRIVE_IDLE_RISE + DRIVE_HEATING * square
        self._drive_rise += (steady - self._drive_rise) * seconds / DRIVE_TIME_CONSTANT
        if faults is not self._faults:
            self._inject(faults)
        if self.supply < MIN_LOGIC_SUPPLY:
            self._lose_power()
            return
        if not self.powered:
            self._gain_power(motion)
        self._update_lag(seconds, motion)
        if (faults.encoder > 0.0) != (self._frozen is not None):
            self._update_encoder_loss(motion)
        self._update_faults(motion)

    def _inject(self, faults: DriveFaults) -> None:
        """Set the injected faults."""
        causes = [cause for name, cause in INJECTED.items() if getattr(faults, name) > 0.0]
        status, latch = (sum(column) for column in zip(Cause(0, 0), *causes, strict=True))
        self._faults, self._injected = faults, Cause(status, latch)

    def _update_lag(self, seconds: float, motion: Motion) -> None:
        """Update the lag behind the profile, which occurs in position mode at the current limit."""
        mode, goal, speed, acceleration = self.demand
        is_limited = abs(motion.current) >= 0.999 * self._link.drive.max_current
        if mode != MODE_POSITION or not is_limited:
            self._speed, self._lag = motion.qd, 0.0
            return
        error = goal - motion.q
        target_speed = (
            copysign(min(speed, sqrt(2.0 * acceleration * abs(error))), error) if speed else 0.0
        )
        max_change = acceleration * seconds
        self._speed += max(-max_change, min(target_speed - self._speed, max_change))
        self._lag += (self._speed - motion.qd) * seconds

    def _update_faults(self, motion: Motion) -> None:
        """Update the status bits of present faults, and latch faults."""
        status, latch = self._injected
        if abs(motion.current) >= 0.999 * self._link.drive.max_current:
            status |= CURRENT_LIMITED
        if abs(self._lag) > LAG_WARNING:
            status |= TRACKING_WARNING
        for cause, holds in (
            (UNDERVOLTAGE, self.supply < MIN_SUPPLY),
            (OVERVOLTAGE, self.supply > MAX_SUPPLY),
            (DRIVE_HOT, self.temperature > MAX_DRIVE_TEMPERATURE - self._hysteresis(DRIVE_HOT)),
            (
                MOTOR_HOT,
                self.motor_temperature > MAX_MOTOR_TEMPERATURE - self._hysteresis(MOTOR_HOT),
            ),
            (TRACKING, abs(self._lag) > MAX_LAG or self.latched & TRACKING.latch),
        ):
            if holds:
                status, latch = status | cause.status, latch | cause.latch
        self._status_bits, self.latched = status, self.latched | latch

    def _hysteresis(self, cause: Cause) -> float:
        """Return the hysteresis of a temperature limit: 0 unless it was exceeded [K]."""
        return HYSTERESIS if self._status_bits & cause.status else 0.0

    def _update_encoder_loss(self, motion: Motion) -> None:
        """Lose the encoder, or regain it without the counts that were missed."""
        if self._frozen is None:
            self._frozen, self.referenced = self._encoder.reading(motion.q), False
        else:
            self._zero += self._encoder.reading(motion.q) - self._frozen
            self._frozen = None

    def _lose_power(self) -> None:
        """Lose power, and with it reference, faults and demand."""
        self.powered = self.referenced = False
        self.latched = self._status_bits = 0
        self._frozen, self.demand = None, DEMAND_OFF

    def _gain_power(self, motion: Motion) -> None:
        """Regain power, and count from the present encoder angle."""
        self.powered, self._was_reset = True, WAS_RESET
        self._zero, self.homings = self._encoder.reading(motion.q), 0
