"""Detection and isolation of valves that stay open or closed, from momentum.

From one moment to another the base's twist is predicted from momentum, from the commands to the
valves and from the motion of the joints,

    x'_b = H_bb^-1 (g + dg - H_bm q'_m),

and also under each hypothesis that one valve stayed open or closed. A fault is found if the
fault-free prediction does not fit the measurement and one single fault does, at several moments in
a row (Chow and Willsky 1984). The mass of the held body matters only for the impulse of the valves,
which then has a larger error; moving joints enlarge the error, too. A valve that stays open and an
opposite one that stays closed while it is commanded all the time have the same effect. In that
case, and if no single valve explains the measurement, an unknown push is reported.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kernels import Floats

from .caught import Sample

SPACING = 0.2  # between moments [s]
SPANS = 5, 10, 15  # spans over which moments are compared, in moments
AGREED = 3  # consecutive moments that must find the same valve
# Sums of 3 squares: limit of chance; limit for an explanation; least gap between explanations.
STRANGE, EXPLAINED, APART = 25.0, 16.0, 6.0
WALK = np.array([0.005, 0.005, 0.0015])  # random walk of other pushes [N sqrt(s)], [N m sqrt(s)]
EVEN = np.array([0.015, 0.015, 0.002])  # constant push, as of a table tilted by 0.1 mrad [N], [N m]
OTHER = 0.1  # relative error of a fault's impulse


Suspect = tuple[str, int]  # "open" or "closed", and the number of the valve


class Faults(NamedTuple):
    """Valves, numbered from 0, that stay open or closed."""

    open: frozenset[int] = frozenset()
    closed: frozenset[int] = frozenset()
    pushed: bool = False  # momentum changes now, and no known cause explains it


class Moment(NamedTuple):
    """State of base and arm at one time, and impulses of the valves since a common start."""

    sample: Sample
    told: Floats  # (v, 3) impulse of each valve as commanded: [N s] and about the world's origin
    open: Floats  # (v, 3) impulse if the valve had always been open


class ValveFaults:
    """Monitor of the valves.

    Args:
        thrust_error: relative error of the thrust, 1 sigma.
    """

    def __init__(self, thrust_error: float) -> None:
        self.thrust_error = thrust_error
        self.found = Faults()
        self._moments: deque[Moment] = deque(maxlen=max(SPANS) + 1)
        self._suspects: deque[Suspect | None] = deque(maxlen=AGREED)  # None: no single valve

    def forget(self) -> None:
        """Reset the comparison: momentum has changed, or was unknown for a while."""
        self._moments.clear()
        self._suspects.clear()
        self.found = self.found._replace(pushed=False)

    def is_due(self, t: float) -> bool:
        """Return True if a moment is due at a time [s]; never after an open valve."""
        if self.found.open:
            return False
        return not self._moments or t >= self._moments[-1].sample.t + SPACING

    def look(self, p: Floats, moment: Moment, mass_error: float) -> None:
        """Add a moment, and update `found`.

        Args:
            p: (8 + 6 n,) of base, arm and held body.
            moment: later than the moments before.
            mass_error: of the held body, 1 sigma [kg].
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
        if kind == "open":  # this valve may have caused earlier findings of closed ones
            self.found = Faults(open=frozenset({valve}))
        else:
            self.found = self.found._replace(closed=self.found.closed | {valve})

    def _compare(
        self, p: Floats, begin: Moment, end: Moment, mass_error: float
    ) -> tuple[bool, Suspect | None]:
        """Compare two moments.

        Returns:
            True if the change is unexplained, and the only fault that explains it; None: there is
            no such fault.
        """
        first, last = begin.sample, end.sample
        H, before = inertia_matrix(p, last.q)[:3], inertia_matrix(p, first.q)[:3]
        inverse = np.linalg.inv(H[:, :3])
        kept = inverse @ moved(first.q[:2], last.q[:2]) @ before  # earlier rates to the twist now
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
    """Return the matrix (3, 3) that takes a momentum about one point (2,) to another."""
    x, y = begin - end
    return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-y, x, 1.0]])


def to_point(at: Floats) -> Floats:
    """Return the matrix (3, 3) that takes a momentum about the world's origin to a point (2,)."""
    return moved(np.zeros(2), at)
