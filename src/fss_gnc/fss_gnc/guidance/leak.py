"""Whether something pushes what should coast: a valve that does not close."""

import numpy as np
import numpy.typing as npt

from fss_arm_model.momentum import momentum

Floats = npt.NDArray[np.float64]

WINDOW = 3.0  # [s]
SHUT = 0.5  # after the last order, within which control, base and board end the last pulse [s]
# An open valve gives half a newton second in the window; a table out of level by 0.1 mrad, 0.06.
IMPULSE = 0.2  # [N s]
TURNING = 0.04  # of it about the centre of mass, where a pair of valves leaks [N m s]


class Leak:
    """Compares momentum with what it was a little before, valves shut."""

    def __init__(self) -> None:
        self._shut, self._since, self._had = -np.inf, np.inf, np.zeros(3)
        self.words = ""  # of what was given at the last look

    def forget(self, t: float) -> None:
        """Valves may be opened at t [s]."""
        self._shut, self._since = t + SHUT, np.inf

    def pushes(self, t: float, p: Floats, q: Floats, qd: Floats) -> bool:
        """Whether momentum has changed since valves closed.

        Args:
            t: [s].
            p: (8 + 6 n,) Arm.vector(), what is held included.
            q: (3 + n,) state.
            qd: (3 + n,) its rate.
        """
        if t < self._shut:
            return False
        has = momentum(p, q, qd)
        if not 0.0 <= t - self._since <= WINDOW:
            self._since, self._had = t, has
        given = np.abs(has - self._had)
        force, turn = float(np.hypot(*given[:2])), float(given[2])
        self.words = f"{force:.2f} N s and {turn:.3f} N m s in {t - self._since:.1f} s"
        return force > IMPULSE or turn > TURNING
