"""Resources that an activity has used, and clearances, for results and mission/state."""

from dataclasses import dataclass, field

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import gaps, sizes, with_edge, with_target
from fss_arm_model.held import with_payload
from fss_arm_model.momentum import momentum
from fss_gnc.guidance.activity import Craft, Observation
from fss_gnc.guidance.free_space import held_gap


def _nan_vector() -> Floats:
    return np.full(3, np.nan)


@dataclass
class Budget:
    """Resources and clearances of one activity; NaN is unknown."""

    craft: Craft
    elapsed: float = 0.0  # [s]
    initial_propellant: float = np.nan  # [kg]
    propellant: float = np.nan  # used since [kg]
    largest_torque: float = np.nan  # at a joint [N m]
    momentum: Floats = field(default_factory=_nan_vector)  # [N s, N s, N m s]
    edge_gap: float = np.nan  # least gap of a body or the held target to the table's edge [m]
    target_gap: float = np.nan  # least gap to the target, of base and arm without gripper [m]

    def update(self, obs: Observation) -> None:
        """Update it from the known state."""
        self.elapsed = obs.t
        if np.isnan(self.initial_propellant):
            self.initial_propellant = obs.propellant
        self.propellant = self.initial_propellant - obs.propellant
        if obs.effort is not None:
            largest = np.fmax.reduce(np.abs(obs.effort))  # NaN is ignored
            self.largest_torque = float(np.fmax(self.largest_torque, largest))
        self.momentum, self.edge_gap, self.target_gap = _nan_vector(), np.nan, np.nan
        if obs.base is None or obs.q is None:
            return
        q, qd = obs.floating_state
        p, n, s = self.craft.arm.vector(), self.craft.arm.n, self.craft.settings
        body_sizes = sizes(s, s.target_radius, s.gripper_length)
        held = obs.held_body if obs.holds else None
        self.momentum = momentum(p if held is None else with_payload(p, *held), q, qd)
        self.edge_gap = float(gaps(p, q, list(with_edge(n)), body_sizes).min())
        if held is not None:
            self.edge_gap = min(self.edge_gap, float(held_gap(p, q, held[1], s.target_radius, s)))
        if obs.target is not None:
            pairs = list(with_target(n))[:-1]
            self.target_gap = float(gaps(p, q, pairs, body_sizes, obs.target.pose[:2]).min())
