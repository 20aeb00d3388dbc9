"""Supervision of a trajectory: tracking errors of the joints, from telemetry, and their limits."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_driver.arm.request import Code, TrajectoryError
from fss_arm_driver.arm.state import LinkState
from fss_arm_driver.arm.tolerance import Tolerances
from fss_arm_driver.arm.trajectory import Trajectory
from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND

END_MARGIN = SECOND // 10  # before the end, when a link may have arrived already [ns]


class Progress(NamedTuple):
    """Desired and actual states of all joints (n), each at its last measurement."""

    time: float  # of the newest measurement, since the start [s]
    desired: tuple[Floats, Floats]  # q [rad], qd [rad/s]
    actual: tuple[Floats, Floats]


@dataclass(frozen=True)
class TrajectoryMonitor:
    """Monitor of the links on a trajectory.

    Args:
        start_timeout: time after the start within which a link must follow its path [s].
    """

    trajectory: Trajectory
    tolerances: Tolerances
    start_timeout: float

    def progress(self, links: Mapping[int, LinkState]) -> Progress:
        """Return the desired and the actual state of each joint at its last measurement."""
        states = [links[i] for i in sorted(links)]
        q, qd = np.empty((2, len(states)))
        for i, state in enumerate(states):
            desired = self.trajectory.at(state.measured)
            q[i], qd[i] = desired[0][i], desired[1][i]
        actual = np.array([s.q for s in states]), np.array([s.qd for s in states])
        newest = max(s.measured for s in states)
        return Progress((newest - self.trajectory.begin) / SECOND, (q, qd), actual)

    def is_goal_reached(self, links: Mapping[int, LinkState]) -> bool:
        """Return True if all joints are at the goal.

        Raises:
            TrajectoryError: a joint left the path, or did not reach the goal in time.
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
                reached &= self._is_at_goal(i, state, error)
        return reached

    def _check_path(self, i: int, state: LinkState, error: tuple[float, float]) -> None:
        begin, end = self.trajectory.begin, self.trajectory.end
        if state.measured < begin:
            return
        if off := self.tolerances.path[i - 1].violation(*error):
            raise TrajectoryError(Code.PATH_TOLERANCE_VIOLATED, f"joint_{i} {off}")
        due = begin + round(self.start_timeout * SECOND)
        if due < state.measured < end - END_MARGIN and not state.following:
            why = "left its path" if state.broken else "does not follow its path"
            raise TrajectoryError(
                Code.PATH_TOLERANCE_VIOLATED, f"link {i} {why}: error {abs(error[0]):.4f} rad"
            )

    def _is_at_goal(self, i: int, state: LinkState, error: tuple[float, float]) -> bool:
        off = self.tolerances.goal[i - 1].violation(*error)
        late = (state.measured - self.trajectory.end) / SECOND
        if off and 0.0 < self.tolerances.goal_time < late:
            words = f"joint_{i} {off}, {late:.2f} s after the end of the trajectory"
            raise TrajectoryError(Code.GOAL_TOLERANCE_VIOLATED, words)
        return not off
