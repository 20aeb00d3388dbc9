"""Allocation of a wrench to on/off valves: which to open in a period, and for how long.

If valve i is open for the share u_i of a period, its mean wrench over the period is u_i B_i. The
shares for the desired mean w are the solution of

    min |S (B u - w)|^2 + (kappa sum u)^2,   0 <= u <= 1

by least squares with bounds (Stark and Parker 1995, as in scipy). The small kappa selects, among
shares with the same wrench, those that need the least propellant. S weights a newton metre in
newtons. A share becomes a pulse; if it is below the shortest pulse, it becomes none or the shortest
one. The difference to the desired impulse is carried over to the next period, so that small
wrenches are correct on average.
"""

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats

PROPELLANT_WEIGHT = 1e-3  # kappa, relative to the strongest valve's force
CLIPPING_TOLERANCE = 0.01  # smallest clipped force, relative to the strongest valve's force


class Allocation:
    """Allocator of wrenches to valves, one period after another.

    Args:
        valves: (k, 3) force in the base's axes [N] and torque about its origin [N m] of each.
        period: [s].
        minimum_on_time: of a valve [s].
        stuck_open: numbers of valves that cannot close, from 0.
        stuck_closed: numbers of valves that cannot open.

    Raises:
        ValueError: a valve that does not exist is stuck, or the shortest pulse exceeds the period.
    """

    def __init__(
        self,
        valves: npt.ArrayLike,
        period: float,
        minimum_on_time: float,
        stuck_open: Collection[int] = (),
        stuck_closed: Collection[int] = (),
    ) -> None:
        from scipy.optimize import lsq_linear  # imported late: the first pulse need not wait

        self._fit = lsq_linear
        self.valves = np.asarray(valves, dtype=float)
        count = len(self.valves)
        stuck = {*stuck_open, *stuck_closed}
        if not stuck <= set(range(count)):
            raise ValueError(
                f"stuck valves are {sorted(stuck)}, expected numbers from 0 to {count - 1}"
            )
        if not 0.0 <= minimum_on_time < period:
            raise ValueError(
                f"minimum_on_time is {minimum_on_time} s, expected from 0 to below {period} s"
            )
        self.period, self.minimum_on_time = period, minimum_on_time
        self._working = np.array([i for i in range(count) if i not in stuck], dtype=int)
        self._leaks = self.valves[list(stuck_open)].sum(axis=0)
        strongest = np.abs(self.valves).max(axis=0)
        force = float(strongest[:2].max())
        self._scale = np.array([1.0, 1.0, force / strongest[2] if strongest[2] else 1.0])
        effect = (self.valves[self._working] * self._scale).T
        self._matrix = np.vstack([effect, np.full(len(self._working), PROPELLANT_WEIGHT * force)])
        self._max_carried = 2.0 * strongest * max(minimum_on_time, 1e-3)  # [N s], [N m s]
        self._carried = np.zeros(3)
        self._tolerance = CLIPPING_TOLERANCE * force
        self.clipped = False  # True if the valves cannot produce the last wrench

    def on_times(self, wrench: npt.ArrayLike) -> Floats:
        """Return the on-times of the valves in the next period, (k,) [s]; set `clipped`.

        Args:
            wrench: (3,) desired mean: force in the base's axes [N], torque about its origin [N m].
        """
        desired = np.asarray(wrench, dtype=float) + self._carried / self.period
        aim = np.append(self._scale * (desired - self._leaks), 0.0)
        shares = self._fit(self._matrix, aim, (0.0, 1.0), method="bvls").x
        missing = np.abs(aim - self._matrix @ shares)[:3]
        carried = np.abs(self._scale * self._carried) / self.period
        self.clipped = bool((missing > carried + self._tolerance).any())
        times = np.zeros(len(self.valves))
        times[self._working] = self._pulses(self.period * shares)
        produced = times @ self.valves + self.period * self._leaks
        carried = self.period * desired - produced
        self._carried = np.clip(carried, -self._max_carried, self._max_carried)
        return times

    def _pulses(self, times: Floats) -> Floats:
        least = self.minimum_on_time
        return np.where(times < 0.5 * least, 0.0, np.clip(times, least, self.period))
