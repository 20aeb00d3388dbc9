"""Impulses of one step in which parts touch, or in which arms hold each other."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.integration import STEP
from fss_sim.plant.contact import GAP, Contact, Scene, impulses
from fss_sim.plant.weld import Weld

GAP_TOLERANCE = 1e-7  # tolerance of a gap at the end of a step [m]


class Impact:
    """Impulses at the start of a step, found by iteration, so that it ends without violations.

    At the end of the step no parts overlap, and each grip has kept its relative pose.

    Args:
        law: law of impact.
        scene: parts of all chains, and the pairs that can touch.
        pairs: (g, 2) pairs of parts that can touch in this step.
        q, v: positions and velocities of all chains.
        inverse: inverse of the inertias of all chains, as one matrix.
        welds: each weld with the slices of v that hold the velocities of its two chains.
    """

    def __init__(
        self,
        law: Contact,
        scene: Scene,
        pairs: Floats,
        q: Floats,
        v: Floats,
        inverse: Floats,
        welds: Sequence[tuple[Weld, slice, slice]],
    ) -> None:
        self._law, self._scene, self._pairs = law, scene, pairs
        self._q, self._v, self._inverse = q, v, inverse
        self._touches = self._scene.touches(q, pairs)
        self._welds = [weld for weld, _, _ in welds]
        self._W = np.zeros((3 * len(welds), v.size))
        for k, (weld, one, other) in enumerate(welds):
            weld.previous = None
            J, other_jacobian = weld.jacobians()
            self._W[3 * k : 3 * k + 3, one] = -J
            self._W[3 * k : 3 * k + 3, other] = other_jacobian
        self._stiff = np.linalg.inv(self._W @ self._inverse @ self._W.T)
        weld_response = self._inverse @ self._W.T
        # The inverse inertia with the grips holding.
        self._welded_inverse = self._inverse - weld_response @ self._stiff @ weld_response.T
        self._weld_gain = weld_response @ self._stiff
        self.touching = np.zeros(self._touches.shape[:2], dtype=bool)  # True where parts touch
        self._contacts = np.zeros((0, 2), dtype=np.intp)
        self._goals, self._speeds_before = np.zeros((2, 0))
        self._last_goals, self._last_gaps = np.zeros((2, 0))
        self._J, self._impulses = np.zeros((0, self._v.size)), np.zeros(0)
        self._impulse = np.zeros(self._v.size)

    @property
    def _bounces(self) -> npt.NDArray[np.bool_]:
        return self._speeds_before < -self._law.threshold

    def add_contacts(self, new: npt.NDArray[np.bool_]) -> None:
        """Add contacts at the places (g, 4) that are True in `new`."""
        if not new.any():
            return
        self.touching |= new
        places = np.argwhere(new)
        touches = self._touches[new]
        J = self._scene.jacobian(self._q, self._pairs[places[:, 0]], touches)
        speeds = (J @ self._v)[::2]
        bounce = -self._law.restitution * speeds
        close_gap = -np.maximum(touches[:, GAP], 0.0) / STEP
        goals = np.where(speeds < -self._law.threshold, bounce, close_gap)
        self._contacts = np.concatenate([self._contacts, places])
        self._J = np.concatenate([self._J, J])
        self._goals = np.concatenate([self._goals, goals])
        # The goals of the previous trial, and below the gaps that resulted from them.
        self._last_goals = np.concatenate([self._last_goals, goals])
        self._last_gaps = np.concatenate([self._last_gaps, np.zeros_like(goals)])
        self._speeds_before = np.concatenate([self._speeds_before, speeds])

    def velocity_change(self) -> Floats:
        """Return the change of velocity that reaches the goals."""
        weld_goals = np.array([weld.goal for weld in self._welds]).ravel()
        welded = self._v + self._weld_gain @ (weld_goals - self._W @ self._v)
        J = self._J
        if self._goals.size:
            self._impulses = impulses(
                J @ self._welded_inverse @ J.T, J @ welded, self._goals, self._law.friction
            )
        self._impulse = J.T @ self._impulses
        missing = weld_goals - self._W @ (self._v + self._inverse @ self._impulse)
        weld_impulses = self._stiff @ missing
        for weld, impulse in zip(self._welds, weld_impulses.reshape(-1, 3), strict=True):
            weld.impulse = impulse
        self._impulse = self._impulse + self._W.T @ weld_impulses
        return self._inverse @ self._impulse

    def correct_goals(self, gaps: Floats) -> bool:
        """Correct the goals by the gaps (g, 4) at the step's end; return True if any changed."""
        welded = [weld.correct_goal() for weld in self._welds]
        if not self._goals.size:
            return any(welded)
        contact_gaps = gaps[tuple(self._contacts.T)]
        unneeded = (self._impulses[::2] > 0.0) & ~self._bounces & (contact_gaps > GAP_TOLERANCE)
        goal_change, gap_change = self._goals - self._last_goals, contact_gaps - self._last_gaps
        slope = gap_change / np.where(goal_change == 0.0, 1.0, goal_change)
        rate = np.where(abs(goal_change) > 1e-9, slope, STEP)
        better = self._goals - contact_gaps / np.clip(rate, 0.1 * STEP, STEP)
        better = np.minimum(better, np.maximum(-self._speeds_before, 0.0))  # more would add energy
        to_correct = ((contact_gaps < -GAP_TOLERANCE) | unneeded) & (better != self._goals)
        self._last_goals, self._last_gaps = self._goals, contact_gaps
        self._goals = np.where(to_correct, better, self._goals)
        return bool(to_correct.any()) or any(welded)

    def work(self) -> float:
        """Return the work of the impulses [J]."""
        return float(self._impulse @ (self._v + 0.5 * self._inverse @ self._impulse))

    def pair_impulses(self) -> Iterator[tuple[int, float]]:
        """Yield the index of each pair that touches, and the impulse that pushes it apart [N s]."""
        for (pair, _), push in zip(self._contacts, self._impulses[::2], strict=True):
            if push > 0.0:
                yield int(pair), float(push)
