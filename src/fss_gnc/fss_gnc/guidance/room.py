"""Whether base and arm, the arm as it is, have room along a path: table's edge, keep-out zone."""

import numpy as np

from fss_arm_model.clearance import body_name, gaps, sizes, with_edge, with_target
from fss_gnc.guidance.activity import ActivityError, Craft, Floats
from fss_gnc.reference import Body, Path

SLACK = 1e-3  # by which what is too near already may come nearer still [m]


class Room:
    """What is free about base and arm; the keep-out zone is a body about the target's origin."""

    def __init__(self, craft: Craft) -> None:
        n, self.margin = craft.arm.n, craft.settings.edge_margin
        self.p, self.n = craft.arm.vector(), n
        self.edge, self.target = list(with_edge(n)), list(with_target(n))
        self.sizes = sizes(craft.settings, craft.settings.keep_out)

    def clearances(self, q: Floats, target: Body | None) -> tuple[float, float]:
        """Least distances to the table's edge and to the keep-out zone [m]; NaN: no target."""
        edge = float(gaps(self.p, q, self.edge, self.sizes).min())
        if target is None:
            return edge, np.nan
        return edge, float(gaps(self.p, q, self.target, self.sizes, target.pose[:2]).min())

    def check(self, path: Path, begin: float, q: Floats, target: Body | None) -> None:
        """Look along the rest of a path, from `begin` [s] on, with the joints where they are.

        What is nearer than it should be already may move away, no nearer.

        Args:
            path: of the base.
            begin: where on it the base is [s].
            q: (n,) of the joints [rad].
            target: as it is at `begin`, to drift on; None: there is none, or it is held.

        Raises:
            ActivityError: bodies would come too near to the edge or into the keep-out zone.
        """
        times, found = path.sampled(begin)
        states = np.hstack([found[:, 0], np.tile(q, (len(times), 1))])
        near = gaps(self.p, states, self.edge, self.sizes)
        self._refuse(near, self.edge, times - begin, self.margin, "the table's edge")
        if target is not None:
            ahead = (times - begin)[:, None] * target.twist[:2]
            near = gaps(self.p, states, self.target, self.sizes, target.pose[:2] + ahead)
            self._refuse(near, self.target, times - begin, 0.0, "the keep-out zone")

    def _refuse(
        self, near: Floats, pairs: list[tuple[int, int]], ahead: Floats, margin: float, what: str
    ) -> None:
        over = np.minimum(margin, near[0] - SLACK) - near
        if over.max() <= 0.0:
            return
        k, pair = np.unravel_index(int(over.argmax()), over.shape)
        raise ActivityError(
            f"{body_name(pairs[pair][0], self.n)} would be {near[k, pair]:.3f} m from {what} in "
            f"{ahead[k]:.1f} s, expected at least {margin:g} m"
        )
