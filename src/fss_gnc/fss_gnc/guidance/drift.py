"""Prediction of collisions of base and arm in a drift, joints held, and pushes that avoid them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model import layout
from fss_arm_model.clearance import gaps, sizes, with_edge, with_target
from fss_gnc.guidance.approach import Rigid, coasted
from fss_gnc.guidance.free_space import held_gap
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.reference import Body

Floats = npt.NDArray[np.float64]

SAMPLES = 16  # per drift
DIRECTIONS = 16
SPEEDS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of the drift speed
STRIDES = (0.1, 0.2, 0.3, 0.45, 0.6, 0.8)  # distances to places to stay at [m]
STAY, ROOM = 120.0, 0.2  # time for which a place must be free [s], and the room around it [m]
MORE = 0.1  # extra room after a push, because the push takes time [m]


class Drift(NamedTuple):
    """Predicted drift of base and arm."""

    twist: Floats  # (3,) of the base, at the start
    edge: float  # least gap to the table's edge [m]
    target: float  # least gap to the target [m]; inf: there is no target
    safe: bool


class Drifting:
    """Predictor of drifts with the joints held.

    Args:
        p: (8 + 6 n,) Arm.vector(), with the present masses.
        settings: sizes and limits.
        held: (3,) place of a held target in the last link's frame (held.py), which must stay on
            the table as well; None: no target is held.
    """

    def __init__(self, p: Floats, settings: MissionSettings, held: Floats | None = None) -> None:
        self.p, self.settings, self.held = p, settings, held
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
        apart = gaps(self.p, q, self._target[:-1], self._sizes, target[:2])
        return edge, float(apart.min())

    def as_is(
        self, q: Floats, qd: Floats, target: Body | None, horizon: float | None = None
    ) -> Drift:
        """Return the drift that follows from the state q and its rate qd, (3 + n,) each.

        Args:
            q: state.
            qd: rate of the state; the joints' rates are ignored.
            target: which drifts as well; None: there is none, or it is held.
            horizon: of the prediction [s]; drift_horizon by default.
        """
        return self._looked(Rigid(self.p, q[3:]), q, np.atleast_2d(qd[:3]), target, horizon)[0]

    def away(self, q: Floats, qd: Floats, target: Body | None) -> Drift:
        """Return the safe drift that needs the least push; if none is safe, that with most room."""
        s, body = self.settings, Rigid(self.p, q[3:])
        w = body.com * np.exp(1j * q[2])
        around = np.exp(2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
        base = complex(*target.twist[:2]) if target is not None else 0j
        of_com = np.append(np.outer(SPEEDS, around).ravel() * s.drift_speed, 0j)
        of_com = np.concatenate([of_com, base + of_com])
        own = complex(*qd[:2]) + 1j * qd[2] * w
        order = np.argsort(np.abs(of_com - own))
        twists = np.column_stack([of_com.real, of_com.imag, np.zeros(of_com.size)])[order]
        found = self._looked(body, q, np.vstack([qd[:3], twists]), target, more=MORE)
        safe = [drift for drift in found if drift.safe]
        return safe[0] if safe else max(found, key=lambda drift: min(drift.edge, drift.target))

    def refuge(self, q: Floats, target: Body | None) -> Floats:
        """Return the nearest pose (3,) at which the base can rest; if none, that with most room."""
        body, still = Rigid(self.p, q[3:]), np.zeros((1, 3))
        around = np.exp(2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
        steps = np.append(0j, np.outer(STRIDES, around).ravel())
        poses = q[:3] + np.column_stack([steps.real, steps.imag, np.zeros(steps.size)])
        stays = [
            self._looked(body, np.concatenate([pose, q[3:]]), still, target, STAY, ROOM)[0]
            for pose in poses
        ]
        safe = [k for k, drift in enumerate(stays) if drift.safe and drift.edge > ROOM]
        room = [min(drift.edge, drift.target) for drift in stays]
        return np.asarray(poses[safe[0] if safe else int(np.argmax(room))])

    def _edge_gap(self, states: Floats) -> Floats:
        """Return the least gap to the edge in states (..., 3 + n), (...) [m]."""
        least: Floats = gaps(self.p, states, self._edge, self._sizes).min(axis=-1)
        if self.held is None:
            return least
        s = self.settings
        return np.minimum(least, held_gap(self.p, states, self.held, s.target_radius, s))

    def _looked(
        self,
        body: Rigid,
        q: Floats,
        twists: Floats,
        target: Body | None,
        horizon: float | None = None,
        more: float = 0.0,
    ) -> list[Drift]:
        s = self.settings
        ahead = np.linspace(0.0, horizon or s.drift_horizon, SAMPLES)
        poses = coasted(q[None, None, :3], twists[:, None, :], body.com, ahead)
        held = np.broadcast_to(body.q_m, (*poses.shape[:2], body.q_m.size))
        states = np.concatenate([poses, held], axis=-1)
        gap = self._edge_gap(states)
        edge = gap.min(axis=1)
        near = np.full(len(twists), np.inf)
        kept = np.ones(len(twists), dtype=bool)
        if target is not None:
            at = target.pose[:2] + ahead[:, None] * target.twist[:2]
            all_gaps = gaps(self.p, states, self._target, self._sizes, at).min(axis=2)
            near = all_gaps.min(axis=1)
            # A gap that is small already, as of the gripper at the fixture, must not become
            # smaller.
            kept = near >= np.minimum(s.least_target + more, all_gaps[:, 0] - 1e-3)
            kept &= all_gaps[:, -1] >= s.least_target + more
        kept &= edge >= np.minimum(s.least_edge + more, gap[:, 0] - 1e-3)
        return [
            Drift(twist, float(e), float(t), bool(k))
            for twist, e, t, k in zip(twists, edge, near, kept, strict=True)
        ]
