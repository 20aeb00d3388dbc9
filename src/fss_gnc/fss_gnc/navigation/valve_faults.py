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

from fss_arm_model.arrays import Floats
from fss_arm_model.dynamics import inertia_matrix

from .mass_estimator import Sample

SPACING = 0.2  # between moments [s]
SPANS = 5, 10, 15  # spans over which moments are compared, in moments
MIN_AGREEMENTS = 3  # consecutive moments that must find the same valve
# Limits of a sum of 3 squares: fault-free, explained by a fault; smallest difference of faults.
DETECTION_LIMIT, EXPLANATION_LIMIT, MIN_SEPARATION = 25.0, 16.0, 6.0
FORCE_WALK = np.array([0.005, 0.005, 0.0015])  # of unknown forces [N sqrt(s)], [N m sqrt(s)]
CONSTANT_FORCE = np.array([0.015, 0.015, 0.002])  # as of a tilt of 0.1 mrad [N], [N m]
FAULT_IMPULSE_ERROR = 0.1  # relative error of a fault's impulse


Suspect = tuple[str, int]  # "open" or "closed", and the number of the valve


class Faults(NamedTuple):
    """Valves, numbered from 0, that stay open or closed."""

    open: frozenset[int] = frozenset()
    closed: frozenset[int] = frozenset()
    unknown_push: bool = False  # momentum changes now, and no known cause explains it


class Moment(NamedTuple):
    """State of base and arm at one time, and impulses of the valves since a common start."""

    sample: Sample
    commanded: (
        Floats  # (v, 3) impulse of each valve as commanded: [N s] and about the world's origin
    )
    always_open: Floats  # (v, 3) impulse if the valve had always been open


class ValveFaults:
    """Monitor of the valves.

    Args:
        thrust_error: relative error of the thrust, 1 sigma.
    """

    def __init__(self, thrust_error: float) -> None:
        self.thrust_error = thrust_error
        self.faults = Faults()
        self._moments: deque[Moment] = deque(maxlen=max(SPANS) + 1)
        self._suspects: deque[Suspect | None] = deque(
            maxlen=MIN_AGREEMENTS
        )  # None: no single valve

    def reset(self) -> None:
        """Reset the comparison: momentum has changed, or was unknown for a while."""
        self._moments.clear()
        self._suspects.clear()
        self.faults = self.faults._replace(unknown_push=False)

    def is_due(self, t: float) -> bool:
        """Return True if a moment is due at a time [s]; never after an open valve."""
        if self.faults.open:
            return False
        return not self._moments or t >= self._moments[-1].sample.t + SPACING

    def update(self, p: Floats, moment: Moment, mass_error: float) -> None:
        """Add a moment, and update `faults`.

        Args:
            p: (8 + 6 n,) of base, arm and held body.
            moment: later than the moments before.
            mass_error: of the held body, 1 sigma [kg].
        """
        self._moments.append(moment)
        comparisons = [
            self._compare(p, self._moments[-1 - span], moment, mass_error)
            for span in SPANS
            if span < len(self._moments)
        ]
        if not any(is_unexplained for is_unexplained, _ in comparisons):
            self._suspects.clear()
            self.faults = self.faults._replace(unknown_push=False)
            return
        suspects = {suspect for _, suspect in comparisons if suspect}
        self._suspects.append(suspects.pop() if len(suspects) == 1 else None)
        if len(self._suspects) < MIN_AGREEMENTS:
            return
        suspect = self._suspects[-1]
        if suspect is None or len({*self._suspects}) > 1:
            self.faults = self.faults._replace(unknown_push=True)
            return
        kind, valve = suspect
        self.reset()
        if kind == "open":  # this valve may have caused earlier findings of closed ones
            self.faults = Faults(open=frozenset({valve}))
        else:
            self.faults = self.faults._replace(closed=self.faults.closed | {valve})

    def _compare(
        self, p: Floats, start: Moment, end: Moment, mass_error: float
    ) -> tuple[bool, Suspect | None]:
        """Compare two moments.

        Returns:
            True if the change is unexplained, and the only fault that explains it; None: there is
            no such fault.
        """
        first, last = start.sample, end.sample
        H, H_start = inertia_matrix(p, last.q)[:3], inertia_matrix(p, first.q)[:3]
        inverse = np.linalg.inv(H[:, :3])
        transfer = inverse @ shift_momentum(first.q[:2], last.q[:2]) @ H_start  # of earlier rates
        by_joints = inverse @ H[:, 3:]
        by_impulse = (
            shift_from_origin(last.q[:2]).T @ inverse.T
        )  # of one about the origin, as a row
        commanded, always_open = (
            end.commanded - start.commanded,
            end.always_open - start.always_open,
        )
        effect = commanded.sum(axis=0) @ by_impulse
        residual = last.qd[:3] - (transfer @ first.qd + effect - by_joints @ last.qd[3:])
        S = last.twist_covariance + transfer[:, :3] @ first.twist_covariance @ transfer[:, :3].T
        duration = last.t - first.t
        S += (
            inverse
            * (np.square(FORCE_WALK) * duration + np.square(CONSTANT_FORCE * duration))
            @ inverse.T
        )
        for rate_noise in (
            by_joints * last.rate_deviations,
            transfer[:, 3:] * first.rate_deviations,
        ):
            S += rate_noise @ rate_noise.T
        mass_variance = (mass_error / H[0, 0]) ** 2
        S += (self.thrust_error**2 + mass_variance) * np.outer(effect, effect)
        if residual @ np.linalg.solve(S, residual) < DETECTION_LIMIT:
            return False, None
        effects = np.concatenate([always_open - commanded, -commanded]) @ by_impulse
        spread = (
            S + (FAULT_IMPULSE_ERROR**2 + mass_variance) * effects[:, :, None] * effects[:, None, :]
        )
        remainders = (residual - effects)[..., None]
        squares = (remainders * np.linalg.solve(spread, remainders)).sum(axis=(1, 2))
        best, second = np.argsort(squares)[:2].tolist()
        if squares[best] > EXPLANATION_LIMIT or squares[second] < squares[best] + MIN_SEPARATION:
            return True, None
        kind, valve = divmod(best, len(commanded))
        return True, ("closed" if kind else "open", valve)


def shift_momentum(start: Floats, end: Floats) -> Floats:
    """Return the matrix (3, 3) that takes a momentum about one point (2,) to another."""
    x, y = start - end
    return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-y, x, 1.0]])


def shift_from_origin(point: Floats) -> Floats:
    """Return the matrix (3, 3) that takes a momentum about the world's origin to a point (2,)."""
    return shift_momentum(np.zeros(2), point)
