"""What is known to accelerate the base: the valves that are open, and the arm as it is planned.

    H_bb a = w - [H_bm qdd_m + h(q, qd)]_b

with the wrench w of the valves. The base filter predicts with the mean of a over each step.
"""

from collections import deque

import numpy as np
import numpy.typing as npt

from fss_arm_model.dynamics import inertia_matrix, inverse_dynamics

Floats = npt.NDArray[np.float64]

KEPT = 5_000_000_000  # [ns], for measurements that come late


class KnownInputs:
    """Remembers commands to the valves, and the arm's reaction at their times.

    Args:
        p: (8 + 6 n,) Arm.vector().
        valves: (k, 3) force in the base's axes [N] and torque about its origin [N m] of each.
        delay: from a command to the thrust [s].
    """

    def __init__(self, p: npt.ArrayLike, valves: npt.ArrayLike, delay: float) -> None:
        self.p, self.valves, self.delay = np.asarray(p), np.asarray(valves), round(1e9 * delay)
        self._commands: deque[tuple[int, Floats, Floats, Floats]] = deque()

    def command(
        self, t: int, on_times: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike,
        qdd_m: npt.ArrayLike,
    ) -> None:  # fmt: skip
        """The valves were commanded at t [ns], later than all before.

        Args:
            t: time of the command [ns].
            on_times: (k,) how long each opens from then on [s]; they replace those before.
            q: (3 + n,) state then.
            qd: (3 + n,) its rate.
            qdd_m: (n,) accelerations of the joints, planned, until the next command [rad/s^2].
        """
        ends = t + self.delay + 1e9 * np.asarray(on_times, dtype=float)
        mobility = np.linalg.inv(inertia_matrix(self.p, q)[:3, :3])
        planned = np.concatenate([np.zeros(3), qdd_m])
        reaction = -mobility @ inverse_dynamics(self.p, q, qd, planned)[:3]
        c, s = np.cos(np.asarray(q)[2]), np.sin(np.asarray(q)[2])
        world = self.valves @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self._commands.append((t, ends, world @ mobility.T, reaction))
        while self._commands[0][0] < t - KEPT:
            self._commands.popleft()

    def acceleration(self, begin: int, end: int) -> Floats:
        """The mean acceleration of the base in the world from `begin` to `end` [ns], (3,)."""
        total, following = np.zeros(3), end
        for t, ends, per_valve, reaction in reversed(self._commands):
            total += max(following - max(begin, t), 0) * reaction
            closed = np.minimum(ends, min(end, following + self.delay))
            total += np.maximum(closed - max(begin, t + self.delay), 0.0) @ per_valve
            following = min(following, t)
            if t + self.delay <= begin:
                break
        return total / (end - begin) if end > begin else total
