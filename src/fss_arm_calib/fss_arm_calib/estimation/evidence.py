"""Interface to data of one kind, as functions of the arm's parameters and its surroundings.

It does not depend on which of these parameters are estimated.
"""

from typing import Protocol

from fss_arm_calib.estimation.least_squares import Floats, Linear


class Evidence(Protocol):
    """Data of one kind, with unknowns of their own that no other data depend on.

    All other quantities that they depend on are in z, (8 + 6 n + 5): Arm.vector(), then
    SURROUNDINGS of fss_arm_model.drifting.
    """

    @property
    def free(self) -> int:
        """Number of observations and of priors on their own unknowns, minus these unknowns."""

    def begin(self) -> Floats:
        """Return initial values of their own unknowns."""

    def near(self, z: Floats, own: Floats) -> Linear:
        """Linearize the observations in z; `extend` appends the step of their own unknowns."""
