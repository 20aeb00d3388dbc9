"""State machine of an experiment: when the arm moves, where to, and when the experiment ends."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Any, NamedTuple

import numpy as np

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.experiment.design import parse_goal
from fss_arm_calib.experiment.settings import ExperimentSettings
from fss_arm_calib.experiment.waypoints import Waypoint, return_waypoints
from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND
from fss_arm_ros.log_line import LogLine

MAX_REPEATS = 3  # largest number of repeats of the rejected rests, or of a maneuver
RETRY_DELAY = 1.0  # before a failed move is requested again [s]
FEEDBACK_TIMEOUT = 3.0  # of a move [s]


@dataclass(frozen=True)
class Progress:
    """Progress of the experiment."""

    begun: int = 0  # start time [ns], 0: not started; earlier observations are ignored
    done: int = 0  # number of completed postures


class Phase(Enum):
    """Phase of the way to a waypoint."""

    REQUEST = auto()  # request the move
    MOVE = auto()  # wait for the end of the move
    OBSERVE = auto()  # wait for the observation, or until the pause is over


class Seen(NamedTuple):
    """Rest or maneuver that a calibration node has found."""

    end: int  # [ns]
    used: bool
    reason: str = ""  # why it is not used
    q: Floats = np.empty(0)  # (n) readings of a rest [rad]


class Sequencer:
    """State machine that takes the arm through waypoints until all are done or the goal is met.

    It starts with the progress of a previous run. Times are those of the node's clock [ns].
    """

    def __init__(
        self, settings: ExperimentSettings, waypoints: Sequence[Waypoint], progress: Progress
    ) -> None:
        self.settings, self.waypoints = settings, list(waypoints)
        done = min(progress.done, len(waypoints))  # without repeats of rejected rests
        self.progress = replace(progress, done=done)
        self.promised: Mapping[str, float] = {}  # deviations that the plan promises, by name
        self.lines: list[LogLine] = []  # not logged yet
        self.exit_code: int | str | None = None  # of the process; None: the experiment continues
        self.status = ""  # the last line about the current move
        self.rests: Sequence[Seen] = ()
        self.maneuvers: Sequence[Seen] = ()
        self.is_observed = False  # True once a calibration node publishes what it has found
        self.goal_met = False
        self.goal_status = ""  # text with the deviations of the goal's parameters
        self.phase = Phase.REQUEST
        self._since = 0  # start of the phase, or last feedback in it [ns]
        self._rounds = 0  # repeats of all rejected rests, or of the current maneuver
        self._arrival = 0  # end of the last move that reached its goal [ns]
        self._last_departure = 0  # end of the last pause, or start of the experiment [ns]
        self._result_stamp = 0  # end of the data of the last calibration result [ns]
        self._way_back: deque[Waypoint] = deque()  # to the start of a maneuver to repeat
        self._unobserved = 0  # number of postures without an observation

    @property
    def waypoint(self) -> Waypoint:
        """Current stop, which the arm moves to or is at."""
        return self._way_back[0] if self._way_back else self.waypoints[self.progress.done]

    @property
    def unfinished(self) -> str:
        """Progress as text; empty if all postures are done."""
        done, path = self.progress.done, self.settings.state_file
        later = f"resumes from {path}" if path else "starts over because state_file is not set"
        words = f"after {done} of {len(self.waypoints)} postures; the next run {later}"
        return words if done < len(self.waypoints) else ""

    def step(self, now: int, is_ready: bool, result: Any = None) -> bool:
        """Advance the experiment; return True if the move to `waypoint` is to be requested.

        At time `now` [ns], the arm can receive a request if it `is_ready`. The result is that of
        the move requested last, as in MoveArm; None: it has not ended.
        """
        self.progress = replace(self.progress, begun=self.progress.begun or now)
        self._last_departure = self._last_departure or now
        if self.goal_met and self._at_rest:
            done = f"{self.progress.done} of {len(self.waypoints)} postures"
            self._exit(0, f"goal met after {done}: {self.goal_status}")
        elif self.progress.done < len(self.waypoints):
            if self.phase is Phase.REQUEST:
                return self._request_move(now, is_ready)
            if self.phase is Phase.MOVE:
                self._await_result(now, result)
            else:
                self._await_observation(now)
        elif not self._repeat_rejected():
            self._finish(now)
        return False

    def reject_move(self, now: int) -> None:
        """Request the move again later: the arm has rejected it."""
        self._log("waiting to move: the goal was rejected; see the log of the node arm")
        self._enter(Phase.REQUEST, now)

    def receive_feedback(self, now: int) -> None:
        """Log the current move and reset its timeout."""
        if self.phase is Phase.MOVE:
            self._since = now
            degrees = np.degrees(self.waypoint.q).round().astype(int)
            self._log(f"{self._title}: moving to {degrees.tolist()} degrees")

    def compare_with_goal(
        self, stamp: int, verdict: str, reason: str, deviations: Mapping[str, float]
    ) -> None:
        """Compare a calibration result, whose data end at `stamp` [ns], with the goal.

        `deviations` are those of the estimated parameters by name.

        Raises:
            ValueError: a parameter of the goal is not estimated.
        """
        self._result_stamp = stamp
        goal = parse_goal(self.settings.goal, list(deviations))
        self.goal_met = verdict == PASS and all(deviations[k] <= x for k, x in goal.items())
        why = f" ({reason})" if verdict != PASS and reason else ""
        self.goal_status = f"{verdict}{why}, " + ", ".join(
            f"{name} ± {deviations[name]:.2g} (goal {limit:.2g}"
            + (f", promised {self.promised[name]:.2g})" if name in self.promised else ")")
            for name, limit in goal.items()
        )

    @property
    def _at_rest(self) -> bool:
        """True if neither a move nor a maneuver is in progress."""
        before = self.waypoints[self.progress.done - 1] if self.progress.done else None
        moving = self.phase is not Phase.REQUEST or bool(self._way_back)
        return not moving and (not before or before.pause != 0.0)

    def _request_move(self, now: int, is_ready: bool) -> bool:
        if not self._has_elapsed(now, RETRY_DELAY) or not self._has_departed(now):
            return False
        if is_ready:
            self._enter(Phase.MOVE, now)
        else:
            self._log("waiting for arm/move")
        return is_ready

    def _has_departed(self, now: int) -> bool:
        """Return True if the delay before the move is over, or if time has jumped back."""
        return not 0 <= now - self._arrival < self.waypoint.delay * SECOND

    def _await_result(self, now: int, result: Any) -> None:
        if result and result.reached:
            self._arrival = now
            self._enter(Phase.OBSERVE, now)
        elif result:
            self._log(f"requesting the move again: {result.message}")
            self._enter(Phase.REQUEST, now)
        elif self._has_elapsed(now, FEEDBACK_TIMEOUT):
            self._log("requesting the move again: no feedback from arm/move")
            self._enter(Phase.REQUEST, now)

    def _await_observation(self, now: int) -> None:
        s, (posture, _, pause, _) = self.settings, self.waypoint
        if pause >= 0.0:
            if self._has_elapsed(now, pause):
                self._finish_maneuver(now)
        elif any(o.end >= self.progress.begun and self._is_at(o, posture) for o in self.rests):
            self._advance(now, "observed")
        elif self.is_observed and self._has_elapsed(now, s.observation_timeout):
            self._give_up(now)
        elif not self.is_observed and self._has_elapsed(now, s.rest):
            self._advance(now, "done, no calibration node observes")

    def _is_at(self, rest: Seen, posture: Floats) -> bool:
        """Return True if a rest is used and its readings are those of a posture."""
        return rest.used and bool(np.abs(posture - rest.q).max() <= self.settings.tolerance)

    def _finish_maneuver(self, now: int) -> None:
        """Continue if the maneuver that ends here was observed; go back if it was rejected."""
        stop, done = self.waypoint, self.progress.done
        planned = stop.pause > 0.0 and done > 0 and not self._way_back
        reasons = [m.reason for m in self.maneuvers if m.end >= self._last_departure]
        timeout = stop.pause + self.settings.observation_timeout
        if not planned or not self.is_observed or (reasons and not any(reasons)):
            self._advance(now, "done")
        elif reasons and self._rounds < MAX_REPEATS:
            self._log(f"{self._title}: {max(reasons)}; returning to repeat it")
            first = max((k for k in range(done) if self.waypoints[k].pause), default=0)
            self._way_back = return_waypoints(self.waypoints[first : done + 1])
            self._rounds, self._last_departure = self._rounds + 1, now
            self.progress = replace(self.progress, done=first + 1)
            self._enter(Phase.REQUEST, 0)
        elif reasons or self._has_elapsed(now, timeout):
            self._give_up(now)

    def _give_up(self, now: int) -> None:
        self._unobserved += 1
        self.lines.append(LogLine(f"{self._title}: not observed", bad=True))
        self._advance(now, "continuing without an observation")

    def _advance(self, now: int, how: str) -> None:
        """Continue with the next posture."""
        if len(self._way_back) == 1:
            self._log(f"back at posture {self.progress.done}")
        elif not self._way_back:
            self._log(f"{self._title}: {how}")
        pause = self.waypoint.pause
        if pause:
            self._last_departure = now
        if self._way_back:
            self._way_back.popleft()
        else:
            self._rounds = 0 if pause > 0.0 else self._rounds
            self.progress = replace(self.progress, done=self.progress.done + 1)
        self._enter(Phase.REQUEST, 0)

    def _repeat_rejected(self) -> bool:
        """Append the postures of rejected rests, which the verdict requires; return True if any."""
        missing = [
            rest.q
            for rest in self.rests
            if not rest.used and rest.end >= self.progress.begun and np.isfinite(rest.q).all()
            if not any(self._is_at(other, rest.q) for other in self.rests)
        ]
        if not missing or self._rounds >= MAX_REPEATS or self.settings.maneuvers:
            return False
        self._rounds += 1
        self.waypoints += [Waypoint(q) for q in missing]
        self._log(f"repeating rejected rests: {len(missing)}")
        return True

    def _finish(self, now: int) -> None:
        """End after the last posture, with failure if a goal is not met.

        If there is a goal, first wait until the calibration has used the last data.
        """
        s, waited = self.settings, now - self._last_departure
        last = max((one.end for one in (*self.rests, *self.maneuvers) if one.used), default=0)
        if s.goal and self._result_stamp < last and 0 <= waited < s.observation_timeout * SECOND:
            self._log("waiting for the calibration")
            return
        missed = f"goal not met: {self.goal_status or 'no calibration result received'}"
        unobserved = f", {self._unobserved} not observed" * (self._unobserved > 0)
        self._exit(missed if s.goal else 0, f"all {len(self.waypoints)} postures done{unobserved}")

    def _exit(self, code: int | str, words: str) -> None:
        self.exit_code = code
        self.lines.append(LogLine(words))

    def _enter(self, phase: Phase, now: int) -> None:
        """Enter a phase; with now = 0, all its waiting times have already passed."""
        self.phase, self._since = phase, now

    def _has_elapsed(self, now: int, seconds: float) -> bool:
        """Return True if the phase is older than `seconds`, or if time has jumped back."""
        return not 0 <= now - self._since < seconds * SECOND

    @property
    def _title(self) -> str:
        """Text that names the current posture."""
        if self._way_back:
            return f"back to posture {self.progress.done}"
        return f"posture {self.progress.done + 1} of {len(self.waypoints)}"

    def _log(self, words: str) -> None:
        """Log a line about the current move if it differs from the last one."""
        if words != self.status:
            self.status = words
            self.lines.append(LogLine(words))
