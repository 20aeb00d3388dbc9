"""Explicit Runge-Kutta methods for the floating arm: classical, and with error control.

Both are built for a law of motion, `act(bodies, forces, turned, z, work, dz)`, that writes dz under
constant `forces`. On entry and on return the bodies are turned to z in `begin`; turned, work and k
are scratch memory.
"""

from collections.abc import Callable

import numpy as np

from .centroidal import advance_rotation
from .kernels import helper, inlined

STEP = 0.001  # step of the classical method, and period of a drive [s]


@inlined
def _accept(bodies, x, z, begin):  # type: ignore[no-untyped-def]
    """Accept x as the new state."""
    advance_rotation(bodies, begin, z, x, begin)
    for r in range(2):
        for i in range(z.shape[1]):
            z[r, i] = x[r, i]


def classical(derivative: Callable[..., None]) -> Callable[..., None]:
    """Return a function that makes one step of fourth order; k is (3 or more, 2, N)."""

    @helper
    def step_forward(bodies, forces, step, z, begin, turned, work, k):  # type: ignore[no-untyped-def]
        x, dx, total, N = k[0], k[1], k[2], z.shape[1]
        for r in range(2):
            for i in range(N):
                x[r, i], total[r, i] = z[r, i], 0.0
        for stage in range(4):
            advance_rotation(bodies, begin, z, x, turned)
            derivative(bodies, forces, turned, x, work, dx)
            weight = step / 6 if stage == 0 or stage == 3 else step / 3
            substep = step if stage == 2 else step / 2
            for r in range(2):
                for i in range(N):
                    total[r, i] += weight * dx[r, i]
                    x[r, i] = z[r, i] + substep * dx[r, i]
        for r in range(2):
            for i in range(N):
                x[r, i] = z[r, i] + total[r, i]
        _accept(bodies, x, z, begin)

    return step_forward


# Dormand & Prince (1980): the stages, the last of which is the solution of fifth order, and the
# difference of this solution and that of fourth order.
STAGES = np.array(
    [
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
ERROR = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
MIN_STEP_SHARE = 1e-3  # shortest step as a share of the time to integrate


def controlled(derivative: Callable[..., None]) -> Callable[..., int]:
    """Return a function that integrates over a time within a tolerance; k is (8, 2, N)."""

    @helper
    def integrate(bodies, forces, time, tolerance, z, begin, turned, work, k):  # type: ignore[no-untyped-def]
        """Integrate over `time` with errors of at most `tolerance` in each of z; return the steps.

        Steps are never shorter than MIN_STEP_SHARE of the time: an abrupt change, such as a
        contact, is then integrated without error control.
        """
        N, done, step, steps = z.shape[1], 0.0, time, 0
        x = k[7]
        while time - done > 1e-9 * time:
            step = min(step, time - done)
            for s in range(7):
                for r in range(2):
                    for i in range(N):
                        x[r, i] = z[r, i]
                        for j in range(s):
                            x[r, i] += step * STAGES[s - 1, j] * k[j, r, i]
                advance_rotation(bodies, begin, z, x, turned)
                derivative(bodies, forces, turned, x, work, k[s])
            worst = 1e-300
            for r in range(2):
                for i in range(N):
                    error = 0.0
                    for j in range(7):
                        error += step * ERROR[j] * k[j, r, i]
                    worst = max(worst, abs(error))
            if worst <= tolerance or step <= MIN_STEP_SHARE * time:
                _accept(bodies, x, z, begin)
                done += step
                steps += 1
            step = max(
                step * min(5.0, max(0.2, 0.9 * (tolerance / worst) ** 0.2)), MIN_STEP_SHARE * time
            )
        return steps

    return integrate
