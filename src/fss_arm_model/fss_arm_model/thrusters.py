"""The base's cold-gas thrusters: their forces, and the mass of gas in a tank."""

import numpy as np

from fss_arm_model.arrays import Floats

COUNT = 8
CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # of the square, in the base's axes
GAS = 287.0  # gas constant of air [J/(kg K)]


def layout(thrust: float, lever: float) -> Floats:
    """Return force on the base in its own axes [N] and torque [N m] of each thruster, (8, 3).

    There are two at each corner of the square, counter-clockwise from the front left corner: the
    first pushes along x towards the centre, the second along y. Each pair of opposite corners can
    give any force or torque alone.
    """
    rows = []
    for x, y in CORNERS:
        rows += [(-x * thrust, 0.0, x * y * thrust * lever)]
        rows += [(0.0, -y * thrust, -x * y * thrust * lever)]
    return np.array(rows)


def gas_mass(pressure: float, volume: float, temperature: float) -> float:
    """Return the mass of air in a tank [kg] as an ideal gas: p V / (R T); Pa, m^3, K."""
    return pressure * volume / (GAS * temperature)
