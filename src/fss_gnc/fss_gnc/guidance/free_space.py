"""Free space of base, arm and held target along a path: table's edge, keep-out zone."""

import numpy as np

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.clearance import body_name, gaps, sizes, with_edge, with_target
from fss_arm_model.extents import Extents
from fss_arm_model.held import payload_pose, payload_positions
from fss_gnc.guidance.activity import ActivityError, Craft, Observation
from fss_gnc.guidance.other_vehicles import SHRINK_TOLERANCE, outline
from fss_gnc.reference import Path


def held_gap(p: Floats, states: Floats, place: Floats, radius: float, extents: Extents) -> Floats:
    """Return the gap from a held target to the table's edge, (...) [m].

    Args:
        p: (8 + 6 n,) Arm.vector().
        states: (..., 3 + n) of base and arm.
        place: (3,) of the target in the last link's frame (held.py).
        radius: of the target [m].
        extents: of the table.
    """
    distance = 0.5 * np.array(extents.table) - np.abs(payload_positions(p, states, place))
    return np.asarray(distance.min(axis=-1) - radius)


class FreeSpace:
    """Free space around base and arm; the keep-out zone is a disc about the target's origin."""

    def __init__(self, craft: Craft) -> None:
        n, self.settings = craft.arm.n, craft.settings
        self.p = craft.arm.vector()
        self.edge, self.target = list(with_edge(n)), list(with_target(n))
        self.names = [body_name(body, n) for body, _ in self.target]  # the same as for the edge
        self.sizes = sizes(self.settings, self.settings.keep_out)

    def check(
        self,
        path: Path,
        start: float,
        obs: Observation,
        every_segment: bool = False,
        tolerance: float = 0.0,
    ) -> None:
        """Check the rest of a path, with the joints held and the target drifting on.

        A body that is already closer than allowed may move away, but no closer.

        Args:
            path: of the base.
            start: time on the path at which the base is now [s].
            obs: the state then; base and joints are known.
            every_segment: check each segment between two knots; takes 0.15 s for 10,000 knots.
            tolerance: allowed decrease of a gap below the margin [m].

        Raises:
            ActivityError: a body would come too close to the edge or into the keep-out zone.
        """
        times, base = path.sample_segments(start) if every_segment else path.sample(start)
        present, _ = obs.floating_state
        states = np.hstack([base[:, 0], np.tile(present[3:], (len(times), 1))])
        gap, names = gaps(self.p, states, self.edge, self.sizes), self.names
        target, s = obs.target, self.settings
        if target is not None and obs.holds:
            place = payload_pose(self.p, present, target.pose)
            gap = np.column_stack([gap, held_gap(self.p, states, place, s.target_radius, s)])
            names = [*names, "the held target"]
        margin, ahead = max(s.edge_margin - tolerance, 0.0), times - start
        self._check_gaps(gap, names, ahead, margin, "the table's edge")
        if target is not None and not obs.holds:
            drifted = target.pose[:2] + ahead[:, None] * target.twist[:2]
            gap = gaps(self.p, states, self.target, self.sizes, drifted)
            self._check_gaps(gap, self.names, ahead, -tolerance, "the keep-out zone")

    def outline(self, obs: Observation) -> Complexes:
        """Return the outline of base, arm and held target (other_vehicles.py)."""
        (q, _), s = obs.floating_state, self.settings
        if not obs.holds or obs.target is None:
            return outline(self.p, q[3:], s)
        return outline(self.p, q[3:], s, payload_pose(self.p, q, obs.target.pose), s.target_radius)

    @staticmethod
    def _check_gaps(
        gap: Floats, names: list[str], ahead: Floats, margin: float, obstacle: str
    ) -> None:
        """Raise ActivityError if a gap (k, names) falls below the margin at times ahead (k,)."""
        excess = np.minimum(margin, gap[0] - SHRINK_TOLERANCE) - gap
        if excess.max() <= 0.0:
            return
        k, body = np.unravel_index(int(excess.argmax()), excess.shape)
        raise ActivityError(
            f"{names[body]} would be {gap[k, body]:.3f} m from {obstacle} in {ahead[k]:.1f} s, "
            f"expected at least {margin:g} m"
        )
