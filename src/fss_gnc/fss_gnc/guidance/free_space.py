"""Free space of base, arm and held target along a path: table's edge, keep-out zone."""

import numpy as np

from fss_arm_model.clearance import body_name, gaps, sizes, with_edge, with_target
from fss_arm_model.extents import Extents
from fss_arm_model.held import held_at, hold
from fss_gnc.guidance.activity import ActivityError, Craft, Floats, Seen
from fss_gnc.reference import Path

SLACK = 1e-3  # by how much a gap that is too small may still shrink [m]


def held_gap(p: Floats, states: Floats, place: Floats, radius: float, extents: Extents) -> Floats:
    """Return the gap from a held target to the table's edge, (...) [m].

    Args:
        p: (8 + 6 n,) Arm.vector().
        states: (..., 3 + n) of base and arm.
        place: (3,) of the target in the last link's frame (held.py).
        radius: of the target [m].
        extents: of the table.
    """
    apart = 0.5 * np.array(extents.table) - np.abs(held_at(p, states, place))
    return np.asarray(apart.min(axis=-1) - radius)


class FreeSpace:
    """Free space around base and arm; the keep-out zone is a disc about the target's origin."""

    def __init__(self, craft: Craft) -> None:
        n, self.settings = craft.arm.n, craft.settings
        self.p = craft.arm.vector()
        self.edge, self.target = list(with_edge(n)), list(with_target(n))
        self.names = [body_name(body, n) for body, _ in self.target]  # the same as for the edge
        self.sizes = sizes(self.settings, self.settings.keep_out)

    def check(self, path: Path, begin: float, seen: Seen, whole: bool = False) -> None:
        """Check the rest of a path, with the joints held and the target drifting on.

        A body that is already closer than allowed may move away, but no closer.

        Args:
            path: of the base.
            begin: time on the path at which the base is now [s].
            seen: the state then; base and joints are known.
            whole: check each segment between two knots, which takes 0.15 s for 10,000 knots.

        Raises:
            ActivityError: a body would come too close to the edge or into the keep-out zone.
        """
        times, found = path.resolved(begin) if whole else path.sampled(begin)
        here, _ = seen.floating
        states = np.hstack([found[:, 0], np.tile(here[3:], (len(times), 1))])
        near, names = gaps(self.p, states, self.edge, self.sizes), self.names
        target, s = seen.target, self.settings
        if target is not None and seen.holds:
            place = hold(self.p, here, target.pose)
            near = np.column_stack([near, held_gap(self.p, states, place, s.target_radius, s)])
            names = [*names, "the held target"]
        self._refuse(near, names, times - begin, s.edge_margin, "the table's edge")
        if target is not None and not seen.holds:
            ahead = (times - begin)[:, None] * target.twist[:2]
            near = gaps(self.p, states, self.target, self.sizes, target.pose[:2] + ahead)
            self._refuse(near, self.names, times - begin, 0.0, "the keep-out zone")

    @staticmethod
    def _refuse(near: Floats, names: list[str], ahead: Floats, margin: float, what: str) -> None:
        """Raise ActivityError if a gap (k, names) falls below the margin at times ahead (k,)."""
        over = np.minimum(margin, near[0] - SLACK) - near
        if over.max() <= 0.0:
            return
        k, body = np.unravel_index(int(over.argmax()), over.shape)
        raise ActivityError(
            f"{names[body]} would be {near[k, body]:.3f} m from {what} in {ahead[k]:.1f} s, "
            f"expected at least {margin:g} m"
        )
