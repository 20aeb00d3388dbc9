"""The offset between the joints' stamps and motion capture's, from the arm's own moves.

In the base's frame, the end effector's heading is the sum of the joints' readings and a constant,
whatever the lengths. If a joint's stamp is delta more than motion capture's of the same instant,

    psi(t) = c + Q(t + delta),    Q = q_1 + .. + q_n

over the frames t of a move. delta is searched on a grid and refined by Gauss-Newton. Errors of the
readings' interpolation last for about the time between two readings, so that frames within this
time count as one. The deviation of a move is therefore conservative. With several moves, the
scatter of their offsets gives the deviation.
"""

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan, sqrt

import numpy as np

from fss_arm_calib.segments.joints import Joint
from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND

MAX_MOVE_DURATION = 20.0  # of a longer move, only the last part is used [s]
MIN_ROTATION = 0.1  # moves that turn the end effector less are ignored [rad]
SEARCH_STEP = 0.02  # step of the search [s]
MAX_OFFSET_DEVIATION = 0.05  # moves whose offset has a larger deviation are ignored [s]
SAMPLE_PERIOD = 0.01  # sample period of a move [s]
MIN_MOVES = 5  # number of moves needed to estimate their scatter
MAX_MOVES = 100  # number of moves in the mean; limited because clocks drift


@dataclass(frozen=True)
class Offset:
    """Offset of the joints' stamps relative to motion capture's, with its deviation [s]."""

    value: float = nan
    deviation: float = inf


def estimate_offset(
    t: Floats, q: list[tuple[Floats, Floats]], stamps: Floats, psi: Floats, search: float
) -> Offset:
    """Return the offset that best aligns a move in the readings with the one in motion capture.

    Args:
        t: (2,) start and end of the move, by the joints' stamps [s].
        q: stamps [s] and readings [rad] of each joint, from before the move until after it.
        stamps: (k,) stamps of motion capture [s].
        psi: (k,) the end effector's heading in the base's frame, unwrapped [rad].
        search: largest offset to search for [s]; beyond it, the result is this limit with infinite
            deviation.

    Returns:
        The offset; NaN if the move hardly turns the end effector.
    """
    from scipy.interpolate import PchipInterpolator

    u = np.arange(t[0], t[1], SAMPLE_PERIOD)
    paths = [(PchipInterpolator(*joint), np.clip(u, joint[0][0], joint[0][-1])) for joint in q]
    Q = sum(path(at) for path, at in paths)
    rate = sum(path(at, 1) for path, at in paths)
    if len(u) < 10 or np.ptp(Q) < MIN_ROTATION:
        return Offset()

    def residual(delta: float) -> Floats:
        difference = np.interp(u - delta, stamps, psi) - Q
        return np.asarray(difference - np.mean(difference))

    grid = np.arange(-search, search + 0.5 * SEARCH_STEP, SEARCH_STEP)
    squares = [float(np.sum(residual(delta) ** 2)) for delta in grid]
    best = int(np.argmin(squares))
    if best in (0, len(grid) - 1):
        return Offset(float(grid[best]))
    delta, slope = float(grid[best]), rate - np.mean(rate)
    for _ in range(5):
        delta += float(residual(delta) @ slope / (slope @ slope))
    period = max(float(np.mean(np.diff(readings))) for readings, _ in q)
    variance = float(np.mean(residual(delta) ** 2)) * max(period / SAMPLE_PERIOD, 1.0)
    return Offset(delta, sqrt(variance / float(slope @ slope)))


def find_last_move(joints: Sequence[Joint], end: int, threshold: float) -> tuple[int, int] | None:
    """Return start and end of the used part of the last move before `end` [ns]; None: no move."""
    moving = []
    for joint in joints:
        t, q, _ = joint.samples_within(end - round(MAX_MOVE_DURATION * SECOND), end)
        fast = np.flatnonzero(np.abs(np.diff(q)) > threshold)
        if len(fast):
            moving += [t[fast[0]], t[fast[-1] + 1]]
    return (int(min(moving)), int(max(moving))) if moving else None


class Alignment:
    """Mean offset of the newest moves."""

    def __init__(self, search: float) -> None:
        self.search = search  # largest offset to search for [s]
        self.offset = Offset()
        self.moves: deque[Offset] = deque(maxlen=MAX_MOVES)  # with a finite offset

    def add_move(self, move: Offset) -> None:
        """Update the mean with another move."""
        if isfinite(move.value):
            self.moves.append(move)
        if move.deviation <= MAX_OFFSET_DEVIATION:
            good = [one for one in self.moves if one.deviation <= MAX_OFFSET_DEVIATION]
            self.offset = mean_offset(good)

    @property
    def lower_bound(self) -> float:
        """Lower limit of the offset if it is outside the search for most moves, else 0 [s]."""
        outside = sum(move.deviation == inf for move in self.moves)
        mostly_outside = outside >= MIN_MOVES and 2 * outside > len(self.moves)
        return self.search if mostly_outside else 0.0


def mean_offset(moves: Collection[Offset]) -> Offset:
    """Return the weighted mean of the moves; their scatter gives its deviation if they suffice.

    The error over the deviation from n moves is Student's t with variance (n - 1) / (n - 3).
    """
    values = np.array([move.value for move in moves])
    weights = np.array([move.deviation for move in moves]) ** -2.0
    mean = float(weights @ values / np.sum(weights))
    scatter = float(weights @ (values - mean) ** 2) / max(len(moves) - 3, 1)
    if len(moves) < MIN_MOVES:
        scatter = max(scatter, 1.0)
    return Offset(mean, sqrt(scatter / float(np.sum(weights))))
