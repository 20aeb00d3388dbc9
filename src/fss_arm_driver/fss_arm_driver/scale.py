"""Conversion between a link's raw counts and SI units, with the limits of its description."""

from math import pi
from typing import NamedTuple

from fss_arm_driver.protocol import (
    ACCELERATION_UNIT,
    CURRENT_UNIT,
    MAX_PATH,
    VELOCITY_UNIT,
    Mode,
    Telemetry,
)
from fss_arm_model.description import Link
from fss_arm_model.units import angle_beyond
from fss_link.session import CommandError

# Telemetry outside these margins is rejected. A disarmed arm may be moved by hand faster than its
# drive's limit. An encoder without reference may have an error of up to half a turn.
SPEED_MARGIN = 3.0
CURRENT_MARGIN = 2.0
POSITION_MARGIN = pi  # [rad]
MAX_MAGNITUDE = 1e12  # of any number in a command, as in other messages
REACH_MARGIN = 0.01  # [rad], whatever the time between two frames


class SetPoint(NamedTuple):
    """Command in the protocol's units."""

    mode: Mode
    value: int
    velocity: int
    acceleration: int
    clamped: bool  # a velocity, an acceleration or a current was above the link's limit
    home: bool = False  # home instead


HOME = 2  # as a LinkCommand's mode


class Scale:
    """Units and limits of one link.

    Raises:
        ValueError: a limit does not fit the protocol's 32 bits.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        drive = link.drive
        self.radians_per_count = 2.0 * pi / (drive.direction * drive.counts_per_turn)
        self.radians_per_raw_velocity = VELOCITY_UNIT * self.radians_per_count
        counts_per_radian = abs(1.0 / self.radians_per_count)
        self.velocity_step = VELOCITY_UNIT / counts_per_radian  # of a frame [rad/s]
        self.acceleration_step = ACCELERATION_UNIT / counts_per_radian  # of a frame [rad/s^2]
        self._fastest = SPEED_MARGIN * drive.max_velocity * counts_per_radian  # [counts/s]
        self._reach_margin = REACH_MARGIN * counts_per_radian
        self._largest_velocity = self._fastest / VELOCITY_UNIT
        farthest = counts_per_radian * (max(abs(link.q_min), abs(link.q_max)) + POSITION_MARGIN)
        if max(farthest, self._largest_velocity) >= 2.0**31:
            raise ValueError(
                f"counts_per_turn is {drive.counts_per_turn}: with it the limits of position "
                "or velocity do not fit the 32 bits of a frame"
            )
        edges = [
            q / self.radians_per_count
            for q in (link.q_min - POSITION_MARGIN, link.q_max + POSITION_MARGIN)
        ]
        self._lowest, self._highest = min(edges), max(edges)  # [counts]
        self._largest_current = CURRENT_MARGIN * drive.max_current / CURRENT_UNIT

    def position(self, counts: int) -> float:
        """Convert counts to the joint angle q [rad]."""
        return self.radians_per_count * counts

    def velocity(self, raw: int) -> float:
        """Convert a raw velocity to the joint rate [rad/s]."""
        return self.radians_per_raw_velocity * raw

    def torque(self, counts: int) -> float:
        """Convert counts of the torque sensor to a torque [N m]."""
        sensor = self.link.torque_sensor
        return sensor.gain * (counts - sensor.zero)

    def is_plausible(self, frame: Telemetry) -> bool:
        """Return True if the frame is within the link's bounds."""
        return (
            self._lowest <= frame.position <= self._highest
            and abs(frame.velocity) <= self._largest_velocity
            and abs(frame.current) <= self._largest_current
        )

    def is_reachable(self, counts: int, microseconds: int) -> bool:
        """Return True if the joint can turn by `counts` in this time."""
        return abs(counts) <= self._fastest * 1e-6 * microseconds + self._reach_margin

    def pushes_outward(self, order: SetPoint, counts: int) -> bool:
        """Return True if a current or a velocity pushes a joint at its limit further outward.

        The drive's own soft limits act at once; this check waits for the next telemetry.
        """
        q, push = self.position(counts), order.value * self.radians_per_count
        return order.mode not in (Mode.POSITION, Mode.PATH) and (
            (q >= self.link.q_max and push > 0.0) or (q <= self.link.q_min and push < 0.0)
        )

    def set_point(
        self, mode: int, value: float, velocity: float = 0.0, acceleration: float = 0.0
    ) -> SetPoint:
        """Convert a command in SI units to the protocol's units.

        A current, velocity or acceleration above the link's limit is clamped to it, and a current
        that would make more than the torque allowed; a profile velocity or acceleration of 0 means
        the limit. PATH takes a path's number as its value. HOME takes no numbers.

        Raises:
            CommandError: no such mode, a number that is not finite, is beyond MAX_MAGNITUDE or has
                the wrong sign, a target position outside the limits, or no path's number.
        """
        if mode == HOME:
            return SetPoint(Mode.POSITION, 0, 0, 0, clamped=False, home=True)
        if mode not in (Mode.CURRENT, Mode.VELOCITY, Mode.POSITION, Mode.PATH):
            raise CommandError(f"mode is {mode}, expected 1, 2, 11, 21 or 31")
        numbers = {"set_point": value, "max_velocity": velocity, "max_acceleration": acceleration}
        for name, number in numbers.items():
            if not abs(number) <= MAX_MAGNITUDE:  # NaN, too
                expected = f"a finite number of at most {MAX_MAGNITUDE:g} in size"
                raise CommandError(f"{name} is {number}, expected {expected}")
        drive = self.link.drive
        speed = _profile("max_velocity", velocity, drive.max_velocity)
        gain = _profile("max_acceleration", acceleration, drive.max_acceleration)
        target, clamped = self._target(Mode(mode), value)
        return SetPoint(
            Mode(mode),
            target,
            max(1, round(speed / self.velocity_step)),
            max(1, round(gain / self.acceleration_step)),
            clamped or velocity > speed or acceleration > gain,
        )

    def _target(self, mode: Mode, value: float) -> tuple[int, bool]:
        """Return the set point in the protocol's units, and whether it was clamped."""
        drive = self.link.drive
        if mode == Mode.POSITION:
            low, high = self.link.q_min, self.link.q_max
            if not low <= value <= high:
                raise CommandError(f"set_point is {angle_beyond(value, low, high)}")
            return round(value / self.radians_per_count), False
        if mode == Mode.PATH:
            if not 1 <= value <= MAX_PATH:
                raise CommandError(f"path is {value:g}, expected 1 to {MAX_PATH}")
            return int(value), False
        if mode == Mode.VELOCITY:
            limit, unit = drive.max_velocity, self.radians_per_raw_velocity
        else:
            limit = min(drive.max_current, drive.max_torque / drive.torque_constant)
            unit = drive.direction * CURRENT_UNIT
        return round(max(-limit, min(value, limit)) / unit), abs(value) > limit


def _profile(name: str, value: float, limit: float) -> float:
    if value < 0.0:
        raise CommandError(f"{name} is {value}, expected 0 (the limit) or more")
    return min(value or limit, limit)
