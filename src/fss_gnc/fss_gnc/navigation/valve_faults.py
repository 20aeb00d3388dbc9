"""Valves that stay open or closed, found by what momentum does: fault detection and isolation.

From one moment to another the base's twist is predicted by momentum, by what the valves were told
and by what the joints did,

    x'_b = H_bb^-1 (g + dg - H_bm q'_m),

and so it is under each hypothesis: that one valve stayed open or closed. Where no fault does not
explain what is measured, and one fault alone does, again and again, that is it (Chow and Willsky
1984). The mass of what is held enters by what the valves give alone, which then counts for less; so
do joints that move. A valve that stays open and one that does not, though told all the time,
against it look alike: then, and where no valve explains it, it is said that something pushes.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kernels import Floats

from .caught import Sample

SPACING = 0.2  # of moments [s]
SPANS = 5, 10, 15  # moments over which all is compared
AGREED = 3  # moments in a row at which the same valve is found
# Sums of 3 squares: beyond chance by far, within it, and apart from each other.
STRANGE, EXPLAINED, APART = 25.0, 16.0, 6.0
WALK = np.array([0.005, 0.005, 0.0015])  # of what else pushes [N sqrt(s)], [N m sqrt(s)]
EVEN = np.array([0.015, 0.015, 0.002])  # that pushes evenly, as a table off by 0.1 mrad [N], [N m]
OTHER = 0.1  # relative error of what a fault gives


Suspect = tuple[str, int]  # open or closed, and which


class Faults(NamedTuple):
    """Numbers of valves, from 0, that stay so."""

    open: frozenset[int] = frozenset()
    closed: frozenset[int] = frozenset()
    pushed: bool = False  # momentum changes now, and nothing known explains it


class Moment(NamedTuple):
    """Base and arm, and what the valves did since any time."""

    sample: Sample
    told: Floats  # (v, 3) impulse of each valve as told: [N s] and about the world's origin
    open: Floats  # (v, 3) had it been open all the time


class ValveFaults:
    """Watches the valves.

    Args:
        thrust_error: relative error of the thrust, 1 sigma.
    """

    def __init__(self, thrust_error: float) -> None:
        self.thrust_error = thrust_error
        self.found = Faults()
        self._moments: deque[Moment] = deque(maxlen=max(SPANS) + 1)
        self._suspects: deque[Suspect | None] = deque(maxlen=AGREED)  # None: cannot be told

    def forget(self) -> None:
        """Begin anew: momentum is another one, or was not known for a while."""
        self._moments.clear()
        self._suspects.clear()
        self.found = self.found._replace(pushed=False)

    def is_due(self, t: float) -> bool:
        """Whether a moment is due at a time [s]; none is after an open valve, which ends all."""
        if self.found.open:
            return False
        return not self._moments or t >= self._moments[-1].sample.t + SPACING

    def look(self, p: Floats, moment: Moment, mass_error: float) -> None:
        """Take a moment, and find in `found` what it shows.

        Args:
            p: (8 + 6 n,) of base, arm and what is held.
            moment: later than those before.
            mass_error: of what is held, 1 sigma [kg].
        """
        self._moments.append(moment)
        found = [
            self._compare(p, self._moments[-1 - span], moment, mass_error)
            for span in SPANS
            if span < len(self._moments)
        ]
        if not any(strange for strange, _ in found):
            self._suspects.clear()
            self.found = self.found._replace(pushed=False)
            return
        suspects = {suspect for _, suspect in found if suspect}
        self._suspects.append(suspects.pop() if len(suspects) == 1 else None)
        if len(self._suspects) < AGREED:
            return
        suspect = self._suspects[-1]
        if suspect is None or len({*self._suspects}) > 1:
            self.found = self.found._replace(pushed=True)
            return
        kind, valve = suspect
        self.forget()
        if kind == "open":  # what seemed to be closed before may have been this
            self.found = Faults(open=frozenset({valve}))
        else:
            self.found = self.found._replace(closed=self.found.closed | {valve})

    def _compare(
        self, p: Floats, begin: Moment, end: Moment, mass_error: float
    ) -> tuple[bool, Suspect | None]:
        """Whether what happened between moments is strange, and the one fault that explains it."""
        first, last = begin.sample, end.sample
        H, before = inertia_matrix(p, last.q)[:3], inertia_matrix(p, first.q)[:3]
        inverse = np.linalg.inv(H[:, :3])
        kept = inverse @ moved(first.q[:2], last.q[:2]) @ before  # twist now by rates then
        by_joints = inverse @ H[:, 3:]
        by_impulse = to_point(last.q[:2]).T @ inverse.T  # of one about the origin, as a row
        told, wide = end.told - begin.told, end.open - begin.open
        given = told.sum(axis=0) @ by_impulse
        off = last.qd[:3] - (kept @ first.qd + given - by_joints @ last.qd[3:])
        S = last.base + kept[:, :3] @ first.base @ kept[:, :3].T
        lasts = last.t - first.t
        S += inverse * (np.square(WALK) * lasts + np.square(EVEN * lasts)) @ inverse.T
        for loose in (by_joints * last.joints, kept[:, 3:] * first.joints):
            S += loose @ loose.T
        vague = (mass_error / H[0, 0]) ** 2
        S += (self.thrust_error**2 + vague) * np.outer(given, given)
        if off @ np.linalg.solve(S, off) < STRANGE:
            return False, None
        effects = np.concatenate([wide - told, -told]) @ by_impulse
        spread = S + (OTHER**2 + vague) * effects[:, :, None] * effects[:, None, :]
        apart = (off - effects)[..., None]
        squares = (apart * np.linalg.solve(spread, apart)).sum(axis=(1, 2))
        best, second = np.argsort(squares)[:2].tolist()
        if squares[best] > EXPLAINED or squares[second] < squares[best] + APART:
            return True, None
        kind, valve = divmod(best, len(told))
        return True, ("closed" if kind else "open", valve)


def moved(begin: Floats, end: Floats) -> Floats:
    """(3, 3): of a momentum about one point (2,) that about another."""
    x, y = begin - end
    return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-y, x, 1.0]])


def to_point(at: Floats) -> Floats:
    """(3, 3): of a momentum about the world's origin that about a point (2,)."""
    return moved(np.zeros(2), at)
