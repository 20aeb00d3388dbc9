"""Resources that an activity has used, and clearances, for results and mission/state."""

from dataclasses import dataclass, field

import numpy as np

from fss_arm_model.clearance import gaps, sizes, with_edge, with_target
from fss_arm_model.held import with_held
from fss_arm_model.momentum import momentum
from fss_gnc.guidance.activity import Craft, Floats, Seen


def _unknown() -> Floats:
    return np.full(3, np.nan)


@dataclass
class Budget:
    """Resources and clearances of one activity; NaN is unknown."""

    craft: Craft
    elapsed: float = 0.0  # [s]
    before: float = np.nan  # propellant at the start [kg]
    propellant: float = np.nan  # used since [kg]
    largest_torque: float = np.nan  # at a joint [N m]
    momentum: Floats = field(default_factory=_unknown)  # [N s, N s, N m s]
    edge: float = np.nan  # least gap of a body to the table's edge [m]
    target: float = np.nan  # least gap of base and arm, without the gripper, to the target [m]

    def update(self, seen: Seen) -> None:
        """Update it from the known state."""
        self.elapsed = seen.t
        self.before = seen.propellant if np.isnan(self.before) else self.before
        self.propellant = self.before - seen.propellant
        if seen.effort is not None:
            most = np.fmax.reduce(np.abs(seen.effort))  # NaN is ignored
            self.largest_torque = float(np.fmax(self.largest_torque, most))
        self.momentum, self.edge, self.target = _unknown(), np.nan, np.nan
        if seen.base is None or seen.q is None:
            return
        q, qd = seen.floating
        p, n, s = self.craft.arm.vector(), self.craft.arm.n, self.craft.settings
        around = sizes(s, s.target_radius, s.gripper_length)
        held = seen.held if seen.holds else None
        self.momentum = momentum(p if held is None else with_held(p, *held), q, qd)
        self.edge = float(gaps(p, q, list(with_edge(n)), around).min())
        if seen.target is not None:
            pairs = list(with_target(n))[:-1]
            self.target = float(gaps(p, q, pairs, around, seen.target.pose[:2]).min())
