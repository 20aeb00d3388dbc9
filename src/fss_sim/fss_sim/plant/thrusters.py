"""Model of eight cold-gas thrusters in a square, their valves and their tank."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.integration import STEP
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, setting
from fss_arm_model.thrusters import THRUSTER_COUNT, gas_mass, thruster_wrenches
from fss_arm_model.units import GRAVITY

NEVER_CLOSES = 1e9  # [step]
VALVES_CLOSED = np.zeros((THRUSTER_COUNT, 5))


@dataclass(frozen=True)
class Propulsion(Settings):
    """Parameters of the thrusters, their valves and their tank."""

    thrust: float = setting(0.16, "thrust of one of the thrusters", unit="N", check=POSITIVE)
    lever: float = setting(
        0.11,
        "lever of a thruster: from the base's origin to the line of thrust; same value as "
        "thruster_lever of `navigation`",
        unit="m",
        check=POSITIVE,
    )
    specific_impulse: float = setting(
        34.0, "specific impulse of the thrusters", unit="s", check=POSITIVE
    )
    minimum_on_time: float = setting(
        0.01,
        "shortest time for which a valve can open; shorter pulses do not open it",
        unit="s",
        check=NOT_NEGATIVE,
    )
    valve_delay: float = setting(
        0.005,
        "delay from a command to the start or end of the thrust",
        unit="s",
        check=NOT_NEGATIVE,
    )
    tank_volume: float = setting(0.43e-3, "volume of the gas tank", unit="m^3", check=POSITIVE)
    tank_pressure: float = setting(
        20e6, "initial pressure of the gas tank", unit="Pa", check=POSITIVE
    )
    regulator_pressure: float = setting(
        0.7e6,
        "tank pressure below which the thrust decreases with the pressure",
        unit="Pa",
        check=POSITIVE,
    )
    temperature: float = setting(293.0, "temperature of tank and gas", unit="K", check=POSITIVE)
    bearing_flow: float = setting(
        0.0,
        "air flow from the tank to the bearings of base and links; 0: an external supply "
        "feeds them, and they never fail",
        unit="kg/s",
        check=NOT_NEGATIVE,
    )
    bearing_pressure: float = setting(
        0.4e6,
        "tank pressure below which the bearings do not carry the vehicle",
        unit="Pa",
        check=POSITIVE,
    )


class Thrusters:
    """State of valves and tank; time is counted in steps of the plant.

    Args:
        propulsion: parameters of thrusters, valves and tank.
        used: propellant used before the start [kg].
    """

    def __init__(self, propulsion: Propulsion | None = None, used: float = 0.0) -> None:
        self.propulsion = p = propulsion or Propulsion()
        self.layout = thruster_wrenches(p.thrust, p.lever)
        self.capacity = gas_mass(p.tank_pressure, p.tank_volume, p.temperature)  # [kg]
        self.propellant_used = min(used, self.capacity)  # propellant [kg]
        self._start, self._end = (
            np.zeros(THRUSTER_COUNT),
            np.zeros(THRUSTER_COUNT),
        )  # of each pulse [step]
        self._stuck_open = self._stuck_closed = np.zeros(THRUSTER_COUNT, dtype=bool)
        self._last_end = 0.0  # of any pulse [step]
        self.pulse_commanded = False  # True if the last command opened a valve

    @property
    def pressure(self) -> float:
        """Pressure of the tank [Pa], for an isothermal tank."""
        return self.propulsion.tank_pressure * (1.0 - self.propellant_used / self.capacity)

    @property
    def thrust(self) -> float:
        """Present thrust of an open thruster, as a fraction of its full thrust."""
        return min(1.0, self.pressure / self.propulsion.regulator_pressure)

    @property
    def floats(self) -> bool:
        """Return True if the air bearings carry the vehicle."""
        p = self.propulsion
        return not p.bearing_flow or self.pressure > p.bearing_pressure

    @property
    def broken(self) -> int:
        """Valves that do not open, as bits: bit i is valve i + 1."""
        return sum(1 << i for i, stuck in enumerate(self._stuck_closed) if stuck)

    def set_stuck(self, is_open: Sequence[bool], is_closed: Sequence[bool]) -> None:
        """Make valves stick open or closed, whatever is commanded; both: closed."""
        self._stuck_closed = np.array(is_closed, dtype=bool)
        self._stuck_open = np.array(is_open, dtype=bool) & ~self._stuck_closed

    def _pulses(self, now: int) -> tuple[Floats, Floats]:
        """Return the start and the end of each valve's pulse, with stuck valves [step]."""
        start = np.where(self._stuck_open, 0.0, self._start)
        end = np.where(self._stuck_open, now + NEVER_CLOSES, self._end)
        return start, np.where(self._stuck_closed, start, end)

    def command(self, on_times: Sequence[float], now: int) -> None:
        """Open each valve for a time from now on [s]; 0 closes it.

        A pulse that is shorter than the minimum does not open a valve. An open valve stays open for
        at least the minimum. A valve that is commanded again before it has closed stays open.

        Raises:
            ValueError: if there are not eight times, or one is negative or not finite.
        """
        times = np.asarray(on_times, dtype=float)
        if times.shape != (THRUSTER_COUNT,) or not (np.isfinite(times) & (times >= 0.0)).all():
            raise ValueError(
                f"on times are {times.tolist()}, expected {THRUSTER_COUNT} of 0 or more [s]"
            )
        p, self.pulse_commanded = self.propulsion, bool(times.any())
        at, min_steps = now + round(p.valve_delay / STEP), round(p.minimum_on_time / STEP)
        is_open = self._end > now  # or is about to open
        durations = np.where(times >= p.minimum_on_time, np.round(times / STEP), 0.0)
        self._start = np.where(is_open, self._start, at)
        shortened = np.minimum(np.maximum(at, self._start + min_steps), self._end)
        self._end = np.where(durations > 0.0, at + durations, np.where(is_open, shortened, at))
        self._last_end = float(self._end.max())

    def valves(self, now: int) -> Floats:
        """Return force, torque, start step and end step of each valve, relative to now, (8, 5)."""
        start, end = self._pulses(now)
        pulses = np.stack([start - now, end - now], axis=-1)
        return np.hstack([self.thrust * self.layout, pulses])

    def is_active(self, now: int) -> bool:
        """Return False only if all valves are closed and no pulse is due."""
        return now < self._last_end or bool(self._stuck_open.any())

    def use_bearing_air(self, steps: int) -> float:
        """Take the bearings' air for `steps` steps from the tank; return its mass [kg].

        The flow falls with the pressure upstream of the regulator, as the thrust does.
        """
        flow = self.thrust * self.propulsion.bearing_flow
        used_now = min(flow * STEP * steps, self.capacity - self.propellant_used)
        self.propellant_used += used_now
        return used_now

    def open_valves(self, now: int) -> list[bool]:
        """Return for each valve whether it is open."""
        start, end = self._pulses(now)
        return ((start <= now) & (now < end)).tolist()

    def use_propellant(self, now: int, steps: int) -> float:
        """Take the propellant of the next `steps` steps from the tank; return its mass [kg]."""
        p = self.propulsion
        start, end = self._pulses(now)
        times = np.minimum(end, now + steps) - np.maximum(start, now)
        flow = self.thrust * p.thrust / (p.specific_impulse * GRAVITY)
        used_now = min(
            float(flow * STEP * np.maximum(times, 0.0).sum()), self.capacity - self.propellant_used
        )
        self.propellant_used += used_now
        return used_now
