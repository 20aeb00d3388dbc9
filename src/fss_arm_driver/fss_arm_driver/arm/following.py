"""How the joints follow a trajectory, by what their links report, and whether they may go on."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_driver.arm.request import SECOND, Code, Floats, TrajectoryError
from fss_arm_driver.arm.state import LinkState
from fss_arm_driver.arm.tolerance import Tolerances
from fss_arm_driver.arm.trajectory import Trajectory

MARGIN = SECOND // 10  # before the end, when a link may have arrived [ns]


class Progress(NamedTuple):
    """All joints (n), each when it was measured last: as wanted then, and as it was."""

    time: float  # of the newest measurement since the begin [s]
    desired: tuple[Floats, Floats]  # q [rad], qd [rad/s]
    actual: tuple[Floats, Floats]


@dataclass(frozen=True)
class Following:
    """Judges the links on a trajectory.

    Args:
        patience: time after the begin in which a link may have not heard of its path [s].
    """

    trajectory: Trajectory
    tolerances: Tolerances
    patience: float

    def progress(self, links: Mapping[int, LinkState]) -> Progress:
        """Where the joints are, each against where it should have been then."""
        states = [links[i] for i in sorted(links)]
        q, qd = np.empty((2, len(states)))
        for i, state in enumerate(states):
            wanted = self.trajectory.at(state.measured)
            q[i], qd[i] = wanted[0][i], wanted[1][i]
        actual = np.array([s.q for s in states]), np.array([s.qd for s in states])
        newest = max(s.measured for s in states)
        return Progress((newest - self.trajectory.begin) / SECOND, (q, qd), actual)

    def reached(self, links: Mapping[int, LinkState]) -> bool:
        """Whether all joints are at the goal.

        Raises:
            TrajectoryError: a joint left the path, or is not at the goal in time.
        """
        found = self.progress(links)
        off, rates = (a - b for a, b in zip(found.actual, found.desired, strict=True))
        reached = True
        for i, state in sorted(links.items()):
            error = float(off[i - 1]), float(rates[i - 1])
            if state.measured < self.trajectory.end:
                self._check_path(i, state, error)
                reached = False
            else:
                reached &= self._is_there(i, state, error)
        return reached

    def _check_path(self, i: int, state: LinkState, error: tuple[float, float]) -> None:
        begin, end = self.trajectory.begin, self.trajectory.end
        if state.measured < begin:
            return
        if off := self.tolerances.path[i - 1].violated(*error):
            raise TrajectoryError(Code.PATH_TOLERANCE_VIOLATED, f"joint_{i} {off}")
        due = begin + round(self.patience * SECOND)
        if due < state.measured < end - MARGIN and not state.following:
            why = "left its path" if state.broken else "does not follow its path"
            raise TrajectoryError(
                Code.PATH_TOLERANCE_VIOLATED, f"link {i} {why}, {abs(error[0]):.4f} rad from it"
            )

    def _is_there(self, i: int, state: LinkState, error: tuple[float, float]) -> bool:
        off = self.tolerances.goal[i - 1].violated(*error)
        late = (state.measured - self.trajectory.end) / SECOND
        if off and 0.0 < self.tolerances.goal_time < late:
            words = f"joint_{i} {off}, {late:.2f} s after the end of the trajectory"
            raise TrajectoryError(Code.GOAL_TOLERANCE_VIOLATED, words)
        return not off
