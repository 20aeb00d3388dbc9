"""What data of one kind say of an arm and of what acts on it, whoever estimates which of these."""

from typing import Protocol

from fss_arm_calib.estimation.least_squares import Floats, Linear


class Evidence(Protocol):
    """Data of one kind, with unknowns of their own that nobody else asks for.

    All else they may depend on is z, (8 + 6 n + 5): Arm.vector(), then SURROUNDINGS, as
    fss_arm_model.drifting has them.
    """

    @property
    def free(self) -> int:
        """Observations, and what is believed of their own unknowns, less these."""

    def begin(self) -> Floats:
        """Their own unknowns to begin with."""

    def near(self, z: Floats, own: Floats) -> Linear:
        """The observations near some values, by z alone; `extend` appends the step of their own."""
