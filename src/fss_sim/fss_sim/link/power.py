"""Power supply: a lithium-ion battery, and the converter that supplies a drive from it.

A battery of open-circuit voltage U and resistance R supplies the electronics with a current I
through a linear regulator, and the converter with a power P. Its voltage V is the larger root of

    V = U - R (I + P / V)

The power of the converter is limited by its maximum, and so that its minimum input voltage remains.
If the drive needs more power, the output voltage of the converter drops.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import exp, sqrt
from typing import NamedTuple

from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, between, setting

#: Open-circuit voltage of an NMC cell at a charge of 0, 5, ... 100% [V]; typical data-sheet values.
CELL = (
    3.00, 3.28, 3.42, 3.49, 3.53, 3.56, 3.58, 3.60, 3.62, 3.64, 3.67,
    3.70, 3.74, 3.79, 3.85, 3.90, 3.95, 4.00, 4.06, 4.12, 4.20,
)  # fmt: skip
CELLS = 4  # in series
_MEAN = sum(0.5 * (a + b) for a, b in pairwise(CELL)) / (len(CELL) - 1)

AMBIENT = 25.0  # [deg C]
# Of the battery in its enclosure [K/W], [s]; assumed.
THERMAL_RESISTANCE, THERMAL_TIME_CONSTANT = 6.0, 1200.0
TEMPERATURE_COEFFICIENT = 0.02  # relative decrease of the resistance per kelvin

# Battery voltages at which the regulator of the electronics loses and regains its 5 V.
BROWN_OUT_VOLTAGE, RECOVERY_VOLTAGE = 6.5, 7.5  # [V]

OUTPUT_VOLTAGE = 24.0  # of the converter [V]
MIN_INPUT_VOLTAGE = 9.0  # of the converter [V]
MAX_INPUT_POWER = 60.0  # of the converter [W]
EFFICIENCY = 0.88


@dataclass(frozen=True)
class Power(Settings):
    """Parameters of a link's battery and its loads; the base's board has two such batteries."""

    energy: float = setting(89.0, "energy of a link's full battery", unit="W h", check=POSITIVE)
    resistance: float = setting(
        0.1,
        "resistance of a link's battery and its wiring at 25 deg C",
        unit="ohm",
        check=between(0.001, 10.0),
    )
    electronics: float = setting(
        0.15,
        "current of a link's micro-controller and torque converter",
        unit="A",
        check=NOT_NEGATIVE,
    )
    wifi: float = setting(0.1, "current of a link's Wi-Fi", unit="A", check=NOT_NEGATIVE)
    idle: float = setting(2.5, "power of a servo drive that is off", unit="W", check=NOT_NEGATIVE)
    switching: float = setting(
        1.5,
        "additional power of a servo drive that is on, without its motor",
        unit="W",
        check=NOT_NEGATIVE,
    )
    winding: float = setting(2.0, "resistance of a motor", unit="ohm", check=NOT_NEGATIVE)
    base: float = setting(
        1.2, "current of the base's computer and board", unit="A", check=NOT_NEGATIVE
    )
    valve: float = setting(
        0.1, "current of each open valve of the base", unit="A", check=NOT_NEGATIVE
    )


class Battery:
    """Lithium-ion battery with four cells in series.

    Args:
        energy: energy when full [W h].
        resistance: resistance at 25 deg C [ohm].
        charge: initial charge; 1 is full, 0 is empty.
    """

    def __init__(self, energy: float = 89.0, resistance: float = 0.1, charge: float = 1.0) -> None:
        self.charge, self.temperature = charge, AMBIENT  # [deg C]
        self.capacity = 3600.0 * energy / (CELLS * _MEAN)  # [A s]
        self._resistance = resistance
        self.volts = self.open_circuit_voltage  # terminal voltage

    @property
    def open_circuit_voltage(self) -> float:
        """Voltage without a load [V]."""
        at = (len(CELL) - 1) * self.charge
        i = min(int(at), len(CELL) - 2)
        return CELLS * (CELL[i] + (at - i) * (CELL[i + 1] - CELL[i]))

    def draw(
        self, current: float, power: float, seconds: float, extra_resistance: float = 0.0
    ) -> float:
        """Supply a current [A] and a power [W] for a time [s]; update voltage and charge.

        `extra_resistance` is added to its own, for example that of a bad contact [ohm]. Return the
        power supplied [W], limited so that the terminal voltage is at least MIN_INPUT_VOLTAGE.
        """
        warming = exp(TEMPERATURE_COEFFICIENT * (AMBIENT - self.temperature))
        resistance = self._resistance * warming + extra_resistance
        left = self.open_circuit_voltage - resistance * current
        limit = MIN_INPUT_VOLTAGE * (left - MIN_INPUT_VOLTAGE) / resistance
        given = min(power, max(0.0, limit))
        root = sqrt(max(0.0, left * left - 4.0 * resistance * given))
        self.volts = max(0.0, 0.5 * (left + root))
        drawn = current + (given / self.volts if given else 0.0)
        self.charge = max(0.0, self.charge - drawn * seconds / self.capacity)
        heat = THERMAL_RESISTANCE * self._resistance * drawn * drawn
        self.temperature += (AMBIENT + heat - self.temperature) * seconds / THERMAL_TIME_CONSTANT
        return given


class Load(NamedTuple):
    """Electrical load of a servo drive with its motor at one instant."""

    on: bool
    current: float = 0.0  # of the motor [A]
    mechanical: float = 0.0  # power of its torque, below 0 when it brakes [W]


class Supply:
    """Battery of a link, its regulator and its converter.

    Args:
        power: parameters of battery and loads.
        charge: initial charge of the battery, 0 to 1.
    """

    def __init__(self, power: Power | None = None, charge: float = 1.0) -> None:
        self.power = power or Power()
        self.battery = Battery(self.power.energy, self.power.resistance, charge)
        self.volts = OUTPUT_VOLTAGE  # at the output of the converter
        self.regulator_on = charge > 0.0  # True if the regulator supplies the electronics

    def advance(self, load: Load | None, seconds: float, extra_resistance: float = 0.0) -> None:
        """Supply electronics and drive for a time [s]; without a load everything is off.

        `extra_resistance` is added to the battery's own [ohm].
        """
        p, battery = self.power, self.battery
        if load is None or not battery.charge:  # the battery's protection opens when it is empty
            self.volts, self.regulator_on = 0.0, bool(battery.charge)
            battery.volts = battery.open_circuit_voltage
            return
        requested = p.idle
        if load.on:  # the braking resistor dissipates regenerated power
            requested += p.switching
            requested += max(0.0, p.winding * load.current * load.current + load.mechanical)
        requested /= EFFICIENCY
        given = battery.draw(
            p.electronics + p.wifi, min(requested, MAX_INPUT_POWER), seconds, extra_resistance
        )
        self.volts = OUTPUT_VOLTAGE * (given / requested) if requested > 0.0 else OUTPUT_VOLTAGE
        threshold = BROWN_OUT_VOLTAGE if self.regulator_on else RECOVERY_VOLTAGE
        self.regulator_on = battery.volts > threshold
