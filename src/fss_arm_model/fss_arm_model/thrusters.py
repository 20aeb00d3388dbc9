"""The base's cold-gas thrusters: their forces, and the mass of gas in a tank."""

import numpy as np

from fss_arm_model.arrays import Floats

THRUSTER_COUNT = 8
CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # of the square, in the base's axes
AIR_GAS_CONSTANT = 287.0  # specific gas constant of air [J/(kg K)]


def thruster_wrenches(thrust: float, lever: float) -> Floats:
    """Return force on the base in its own axes [N] and torque [N m] of each thruster, (8, 3).

    There are two at each corner of the square, counter-clockwise from the front left corner: the
    first pushes along x towards the centre, the second along y. The four thrusters at two opposite
    corners give, on average, a force along either axis or a torque alone.

    Args:
        thrust: of one thruster [N].
        lever: distance of its line of thrust from the base's origin [m].
    """
    rows = []
    for x, y in CORNERS:
        rows += [(-x * thrust, 0.0, x * y * thrust * lever)]
        rows += [(0.0, -y * thrust, -x * y * thrust * lever)]
    return np.array(rows)


def gas_mass(pressure: float, volume: float, temperature: float) -> float:
    """Return the mass of air in a tank [kg] as an ideal gas: p V / (R T).

    Args:
        pressure: absolute [Pa].
        volume: of the tank [m^3].
        temperature: of the gas [K].
    """
    return pressure * volume / (AIR_GAS_CONSTANT * temperature)
