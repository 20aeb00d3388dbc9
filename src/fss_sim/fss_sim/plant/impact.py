"""Impulses of one step in which parts touch, or in which arms hold each other."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from fss_arm_model.integration import STEP
from fss_arm_model.kernels import Floats
from fss_sim.plant.contact import GAP, Contact, Scene, impulses
from fss_sim.plant.weld import Weld

TOUCH = 1e-7  # tolerance of a gap at the end of a step [m]


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
        self._here = self._scene.touches(q, pairs)
        self._welds = [weld for weld, _, _ in welds]
        self._W = np.zeros((3 * len(welds), v.size))
        for k, (weld, one, other) in enumerate(welds):
            weld.last = None
            J, its = weld.jacobians()
            self._W[3 * k : 3 * k + 3, one] = -J
            self._W[3 * k : 3 * k + 3, other] = its
        self._stiff = np.linalg.inv(self._W @ self._inverse @ self._W.T)
        drawn = self._inverse @ self._W.T
        self._free = self._inverse - drawn @ self._stiff @ drawn.T  # with the grips holding
        self._drawn = drawn @ self._stiff
        self.on = np.zeros(self._here.shape[:2], dtype=bool)  # True where parts touch
        self._at, self._goals, self._before = np.zeros((0, 2), dtype=np.intp), *np.zeros((2, 0))
        self._tried, self._came = np.zeros((2, 0))
        self._J, self._pushes = np.zeros((0, self._v.size)), np.zeros(0)
        self._given = np.zeros(self._v.size)

    @property
    def _bounces(self) -> npt.NDArray[np.bool_]:
        return self._before < -self._law.threshold

    def begin(self, new: npt.NDArray[np.bool_]) -> None:
        """Add contacts at the places (g, 4) that are True in `new`."""
        if not new.any():
            return
        self.on |= new
        more = np.argwhere(new)
        here = self._here[new]
        J = self._scene.jacobian(self._q, self._pairs[more[:, 0]], here)
        before = (J @ self._v)[::2]
        back = -self._law.restitution * before
        there = -np.maximum(here[:, GAP], 0.0) / STEP
        goals = np.where(before < -self._law.threshold, back, there)
        self._at, self._J = np.concatenate([self._at, more]), np.concatenate([self._J, J])
        self._goals = np.concatenate([self._goals, goals])
        # The goals of the previous trial, and below the gaps that resulted from them.
        self._tried = np.concatenate([self._tried, goals])
        self._came = np.concatenate([self._came, np.zeros_like(goals)])
        self._before = np.concatenate([self._before, before])

    def change(self) -> Floats:
        """Return the change of velocity that reaches the goals."""
        wanted = np.array([weld.goal for weld in self._welds]).ravel()
        held = self._v + self._drawn @ (wanted - self._W @ self._v)
        J = self._J
        if self._goals.size:
            self._pushes = impulses(J @ self._free @ J.T, J @ held, self._goals, self._law.friction)
        self._given = J.T @ self._pushes
        missing = wanted - self._W @ (self._v + self._inverse @ self._given)
        held_by = self._stiff @ missing
        for weld, impulse in zip(self._welds, held_by.reshape(-1, 3), strict=True):
            weld.impulse = impulse
        self._given = self._given + self._W.T @ held_by
        return self._inverse @ self._given

    def improve(self, ended: Floats) -> bool:
        """Correct the goals by the gaps (g, 4) at the step's end; return True if any changed."""
        held = [weld.improve() for weld in self._welds]
        if not self._goals.size:
            return any(held)
        off = ended[tuple(self._at.T)]
        rests = (self._pushes[::2] > 0.0) & ~self._bounces & (off > TOUCH)
        tried, came = self._goals - self._tried, off - self._came
        rate = np.where(abs(tried) > 1e-9, came / np.where(tried == 0.0, 1.0, tried), STEP)
        better = self._goals - off / np.clip(rate, 0.1 * STEP, STEP)
        better = np.minimum(better, np.maximum(-self._before, 0.0))  # more would add energy
        wrong = ((off < -TOUCH) | rests) & (better != self._goals)
        self._tried, self._came = self._goals, off
        self._goals = np.where(wrong, better, self._goals)
        return bool(wrong.any()) or any(held)

    def gained(self) -> float:
        """Return the work of the impulses [J]."""
        return float(self._given @ (self._v + 0.5 * self._inverse @ self._given))

    def pushed(self) -> Iterator[tuple[int, float]]:
        """Yield the index of each pair that touches, and the impulse that pushes it apart [N s]."""
        for (pair, _), push in zip(self._at, self._pushes[::2], strict=True):
            if push > 0.0:
                yield int(pair), float(push)
