"""Interface of the joint estimate to the measurements of one kind.

The measurements are functions of the parameters of the arm and its surroundings. The interface does
not depend on which of these parameters are estimated.
"""

from typing import Protocol

from fss_arm_calib.estimation.least_squares import Linear
from fss_arm_model.arrays import Floats


class Measurements(Protocol):
    """Measurements of one kind, with unknowns that no other data depend on (own unknowns).

    All other quantities that they depend on are in z, (8 + 6 n + 5): Arm.vector(), then
    SURROUNDINGS of fss_arm_model.drifting.
    """

    @property
    def degrees_of_freedom(self) -> int:
        """Number of observations and of priors on the own unknowns, minus these unknowns."""

    def initial_unknowns(self) -> Floats:
        """Return initial values of the own unknowns."""

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the residuals in z; `extend` appends the step of the own unknowns."""
