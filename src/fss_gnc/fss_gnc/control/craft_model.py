"""Present mass and inertia of base and arm: with a held body, and without the used gas."""

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.held import Target, payload_pose, with_payload


class CraftModel:
    """Parameters of base, arm and held body.

    Args:
        arm: description of the arm, with a full tank.
        assumed_target: the target, until the held body is measured.
    """

    def __init__(self, arm: Arm, assumed_target: Target) -> None:
        self.arm, self.assumed_target = arm, assumed_target
        self.propellant_used = 0.0  # [kg]
        self.holds_target = False
        self.place: Floats | None = None  # of the held target, in the last link's frame
        self.measured: tuple[Target, Floats] | None = None  # held body and its place, once measured

    @property
    def is_loaded(self) -> bool:
        """True if the parameters include a held body."""
        return self.place is not None or self.measured is not None

    def set_gripper(self, holds: bool) -> None:
        """Set whether the target is part of the arm."""
        self.holds_target = holds
        if not holds:
            self.place = self.measured = None

    def parameters(self, q: Floats, target: Floats | None) -> Floats:
        """Return the present parameters of base and arm, (8 + 6 n,).

        Args:
            q: (3 + n,) state.
            target: (3,) pose of the target in the world; None: it is unknown.
        """
        p = self.arm.vector()
        if self.holds_target and self.place is None and target is not None:
            self.place = payload_pose(p, q, target)
        p[layout.MASS] -= self.propellant_used
        held, place = self.measured or (self.assumed_target, self.place)
        return p if place is None else with_payload(p, held, place)
