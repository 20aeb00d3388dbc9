"""Prediction of collisions of base and arm in a drift, joints held, and pushes that avoid them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import gaps, sizes, with_edge, with_target
from fss_gnc.guidance.approach_trajectory import RigidCraft, propagate_coast
from fss_gnc.guidance.free_space import held_gap
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import OtherVehicle, gap_excess, outline
from fss_gnc.reference import Body

SAMPLE_COUNT = 16  # per drift
DIRECTION_COUNT = 16
SPEED_FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of the drift speed
REFUGE_DISTANCES = (0.1, 0.2, 0.3, 0.45, 0.6, 0.8)  # distances to places to stay at [m]
STAY_TIME, STAY_GAP = 120.0, 0.2  # a refuge must be free for this time [s], with this gap [m]
PUSH_MARGIN = 0.1  # extra gap after a push, because the push takes time [m]


class Drift(NamedTuple):
    """Predicted drift of base and arm."""

    twist: Floats  # (3,) of the base, at the start
    edge: float  # least gap to the table's edge [m]
    target: float  # least gap to the target [m]; inf: there is no target
    safe: bool
    vehicles: float = np.inf  # least gap to another vehicle [m]; inf: there is none


class DriftPredictor:
    """Predictor of drifts with the joints held.

    Args:
        p: (8 + 6 n,) Arm.vector(), with the present masses.
        settings: sizes and limits.
        held: (3,) place of a held target in the last link's frame (held.py), which must stay on
            the table as well; None: no target is held.
        others: the other vehicles; the prediction starts now.
    """

    def __init__(
        self,
        p: Floats,
        settings: MissionSettings,
        held: Floats | None = None,
        others: Sequence[OtherVehicle] = (),
    ) -> None:
        self.p, self.settings, self.held, self.others = p, settings, held, others
        n = (p.size - layout.BASE_SIZE) // layout.LINK_SIZE
        self._edge, self._target = list(with_edge(n)), list(with_target(n))
        self._sizes = sizes(settings, settings.target_radius, settings.gripper_length)

    def clearances(self, q: Floats, target: Floats | None) -> tuple[float, float]:
        """Return the least gaps [m] to the edge, and to the target.

        The gap to the target is that of base and links, without the gripper.
        """
        edge = float(self._edge_gap(q))
        if target is None:
            return edge, np.inf
        target_gaps = gaps(self.p, q, self._target[:-1], self._sizes, target[:2])
        return edge, float(target_gaps.min())

    def predict(
        self, q: Floats, qd: Floats, target: Body | None, horizon: float | None = None
    ) -> Drift:
        """Return the drift that follows from the state q and its rate qd, (3 + n,) each.

        Args:
            q: state.
            qd: rate of the state; the joints' rates are ignored.
            target: drifts as well; None: there is none, or it is held.
            horizon: of the prediction [s]; drift_horizon by default.
        """
        return self._predict_all(
            RigidCraft(self.p, q[3:]), q, np.atleast_2d(qd[:3]), target, horizon
        )[0]

    def plan_push(self, q: Floats, qd: Floats, target: Body | None) -> Drift:
        """Return the safe drift that needs the smallest push; if none is safe, the widest gap."""
        s, body = self.settings, RigidCraft(self.p, q[3:])
        w = body.com * np.exp(1j * q[2])
        directions = np.exp(2j * np.pi * np.arange(DIRECTION_COUNT) / DIRECTION_COUNT)
        target_velocity = complex(*target.twist[:2]) if target is not None else 0j
        com_velocities = np.append(
            np.outer(SPEED_FRACTIONS, directions).ravel() * s.drift_speed, 0j
        )
        com_velocities = np.concatenate([com_velocities, target_velocity + com_velocities])
        present = complex(*qd[:2]) + 1j * qd[2] * w
        v = com_velocities[np.argsort(np.abs(com_velocities - present))]
        twists = np.column_stack([v.real, v.imag, np.zeros(v.size)])
        drifts = self._predict_all(body, q, np.vstack([qd[:3], twists]), target, margin=PUSH_MARGIN)
        safe = [drift for drift in drifts if drift.safe]
        return safe[0] if safe else max(drifts, key=_least_gap)

    def find_refuge(self, q: Floats, target: Body | None) -> Floats:
        """Return the nearest pose (3,) at which the base can rest; if none, the widest gap."""
        body, at_rest = RigidCraft(self.p, q[3:]), np.zeros((1, 3))
        directions = np.exp(2j * np.pi * np.arange(DIRECTION_COUNT) / DIRECTION_COUNT)
        offsets = np.append(0j, np.outer(REFUGE_DISTANCES, directions).ravel())
        poses = q[:3] + np.column_stack([offsets.real, offsets.imag, np.zeros(offsets.size)])
        drifts = [
            self._predict_all(
                body, np.concatenate([pose, q[3:]]), at_rest, target, STAY_TIME, STAY_GAP
            )[0]
            for pose in poses
        ]
        safe = [k for k, drift in enumerate(drifts) if drift.safe and drift.edge > STAY_GAP]
        smallest_gaps = [_least_gap(drift) for drift in drifts]
        return np.asarray(poses[safe[0] if safe else int(np.argmax(smallest_gaps))])

    def _edge_gap(self, states: Floats) -> Floats:
        """Return the least gap to the edge in states (..., 3 + n), (...) [m]."""
        edge_gap: Floats = gaps(self.p, states, self._edge, self._sizes).min(axis=-1)
        if self.held is None:
            return edge_gap
        s = self.settings
        return np.minimum(edge_gap, held_gap(self.p, states, self.held, s.target_radius, s))

    def _predict_all(
        self,
        body: RigidCraft,
        q: Floats,
        twists: Floats,
        target: Body | None,
        horizon: float | None = None,
        margin: float = 0.0,
    ) -> list[Drift]:
        s = self.settings
        times = np.linspace(0.0, horizon or s.drift_horizon, SAMPLE_COUNT)
        poses = propagate_coast(q[None, None, :3], twists[:, None, :], body.com, times)
        joints = np.broadcast_to(body.q_m, (*poses.shape[:2], body.q_m.size))
        states = np.concatenate([poses, joints], axis=-1)
        gap = self._edge_gap(states)
        edge = gap.min(axis=1)
        target_gap = np.full(len(twists), np.inf)
        is_safe = np.ones(len(twists), dtype=bool)
        if target is not None:
            target_path = target.pose[:2] + times[:, None] * target.twist[:2]
            target_gaps = gaps(self.p, states, self._target, self._sizes, target_path).min(axis=2)
            target_gap = target_gaps.min(axis=1)
            # A gap that is small already, as of the gripper at the fixture, must not become
            # smaller.
            is_safe = target_gap >= np.minimum(s.min_target_gap + margin, target_gaps[:, 0] - 1e-3)
            is_safe &= target_gaps[:, -1] >= s.min_target_gap + margin
        is_safe &= edge >= np.minimum(s.min_edge_gap + margin, gap[:, 0] - 1e-3)
        vehicles = np.full(len(twists), np.inf)
        own = outline(self.p, body.q_m, s, self.held, s.target_radius)
        for k, drifting in enumerate(poses if self.others else ()):
            found = [
                gap_excess(own, times, drifting, other, s.vehicle_gap + margin)
                for other in self.others
            ]
            vehicles[k] = min(float(gap.min()) for gap, _ in found)
            is_safe[k] &= all((excess >= 0.0).all() for _, excess in found)
        return [
            Drift(twist, float(e), float(t), bool(k), float(v))
            for twist, e, t, k, v in zip(twists, edge, target_gap, is_safe, vehicles, strict=True)
        ]


def _least_gap(drift: Drift) -> float:
    return min(drift.edge, drift.target, drift.vehicles)
