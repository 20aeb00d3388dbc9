"""Model of a single vehicle on its table."""

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, Base
from fss_arm_model.held import Approach
from fss_sim.plant.bed import Audit, Bed
from fss_sim.plant.target import PassiveTarget
from fss_sim.plant.vehicle import Vehicle, World


class Plant(Vehicle):
    """Single vehicle on its table, with an optional target.

    Args:
        arm, q, qd, world, propellant: as in Vehicle.
        target: (2, 3) initial pose and twist of the target, if there is one.
        holds: whether the gripper holds the target.
    """

    def __init__(
        self,
        arm: Arm | Base,
        q: npt.ArrayLike,
        qd: npt.ArrayLike | None = None,
        world: World | None = None,
        target: npt.ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        holds: bool = False,
        propellant: float = 0.0,
    ) -> None:
        super().__init__(arm, q, qd, world, propellant)
        self._target_state = np.array(target, dtype=float)  # returned if there is no target
        targets = []
        if body := self.world.target:
            targets.append(PassiveTarget(body, target, self.world.surroundings))
        self.closed = holds  # the gripper
        if holds and targets:
            self.attach(targets[0])
        self.bed = Bed([self], targets, self.world.contact, self.world.tolerance)

    def advance(self, seconds: float) -> None:
        """Advance the simulation by a time [s], in whole steps of the drives."""
        self.bed.advance(seconds)

    @property
    def approach(self) -> Approach:
        """Approach of the end effector to the body held, else to the nearest; infinite if none."""
        return self.bed.within_reach(self)[1]

    @property
    def target(self) -> Floats:
        """Pose (x, y [m], heading [rad]) and twist of the target in the world frame, (2, 3)."""
        return self.bed.targets[0].state if self.bed.targets else self._target_state

    @property
    def audit(self) -> Audit:
        """Momentum and energy audit of all bodies at present."""
        return self.bed.audit

    @property
    def imbalance(self) -> Floats:
        """Error of the audit since the start, (4,) [N s, N s, N m s, J]."""
        return self.bed.imbalance

    @property
    def clearance(self) -> float:
        """Least gap between two bodies that are not neighbours [m]."""
        return self.bed.nearest().gap
