"""Node `experiment`: moves the arm through postures to be observed, or through maneuvers."""

import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from fss_arm_calib import state
from fss_arm_calib.acceptance import PASS
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.experiment.design import parse_goal
from fss_arm_calib.experiment.planned import Planned, read_plan
from fss_arm_calib.experiment.postures import default_postures
from fss_arm_calib.experiment.settings import ExperimentSettings
from fss_arm_calib.messages import calibration_part
from fss_arm_calib.programs import experiment as main
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.files import read_yaml
from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import (
    DynamicCalibration,
    KinematicCalibration,
    KinematicObservations,
    Maneuvers,
)
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.validation import subscribe

MAX_REPEATS = 3  # largest number of repeats of the rejected rests, or of a maneuver
MAX_STALL = 2.0  # longest tolerated stall of this process [s]; then only the operator may resume


@dataclass
class Progress:
    """Progress of the experiment."""

    begun: int = 0  # start time [ns], 0: not started; earlier observations are ignored
    done: int = 0  # number of completed postures


class Waypoint(NamedTuple):
    """Posture that the arm moves to."""

    q: Floats  # (n) [rad]
    duration: float = 0.0  # duration of the move [s]; 0: as fast as the arm's limits allow
    pause: float = -1.0  # rest at the posture [s]; < 0: until it has been observed


class ExperimentNode(Node):
    """Node that moves the arm through a list of postures or maneuvers, and then exits.

    The arm leaves a posture when it has been observed, or after a rest if no calibration node
    observes. A maneuver goes from one posture to the next at once, and ends with a pause. If a
    calibration node observes, rejected rests and maneuvers are repeated; before a maneuver is
    repeated, the arm goes back the same way. With a `goal`, the node stops early, as soon as a
    calibration passes with the requested deviations. If none does by the end, the node fails.

    The node never arms a link. Until the operator has armed the links, and after a failed or lost
    move, it requests the move again. It exits if its process was stalled: the arm has stopped by
    then, and must not resume unexpectedly.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("experiment", **options)
        s = self.settings = declare(self, ExperimentSettings)
        self.waypoints = read_waypoints(s)
        plan: Any = read_yaml(Path(s.maneuvers)) if s.maneuvers else {}
        self.promised_deviations = plan.get("promised", {})  # deviations, by name
        self.writer = state.FileWriter(self.get_logger())
        self.progress = self.restore()
        self.progress.done = min(self.progress.done, len(self.waypoints))  # without repeated rests
        self.move_client = ActionClient(self, MoveArm, "arm/move")
        self.keep_alive_publisher = self.create_publisher(UUID, "arm/move/alive", 10)
        self.last_tick = 0.0  # real time of the last tick [s]
        self.observed: list[tuple[int, tuple[float, ...]]] = []  # end [ns], readings [rad]
        self.rejected: list[Floats] = []  # readings [rad]
        self.rounds = 0  # repeats of all rejected rests, or of the current maneuver
        self.is_observed = False  # True once a calibration node publishes observations
        self.maneuvers: list[tuple[int, str]] = []  # end [ns] and rejection reason of each maneuver
        self.last_departure = 0  # end of the last pause, or start of the experiment [ns]
        self.goal_status = ""  # text with the deviations of the goal's parameters
        self.goal_met = False  # True if the goal is met
        self.result_stamp = 0  # stamp of the last calibration result: end of its data [ns]
        self.way_back: deque[Waypoint] = deque()  # back to the start of a maneuver to repeat
        subscribe(
            self, KinematicObservations, "calibration/observations", self.on_observations, LATCHED
        )
        subscribe(self, Maneuvers, "calibration/maneuvers", self.on_maneuvers, LATCHED)
        if s.goal:
            kind = DynamicCalibration if s.maneuvers else KinematicCalibration
            topic = f"calibration/{'dynamic' if s.maneuvers else 'kinematic'}"
            subscribe(self, kind, topic, self.on_result, LATCHED)
        self.phase: Callable[[int], None] = self.request_move
        self.since = 0  # start of the phase, or last feedback in it [ns]
        self.goal, self.outcome = Future(), Future()
        self.last_log = ""
        self.create_timer(0.1, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health)

    def restore(self) -> Progress:
        """Read the progress of a previous run."""
        path = self.settings.state_file
        try:
            progress = Progress(**state.read(path, {})) if path else Progress()
        except TypeError as error:
            raise state.StateError(
                f"{path} does not contain the progress of an experiment: {error}"
            ) from None
        if progress.done:
            self.get_logger().info(f"resuming after {progress.done} postures")
        return progress

    def save(self) -> None:
        """Save the progress for a later run."""
        if path := self.settings.state_file:
            self.writer.trouble = ""
            self.writer(lambda: state.write(path, asdict(self.progress)))

    def on_observations(self, message: KinematicObservations) -> None:
        """Store the observations received."""
        self.observed = [(stamp_ns(o.end), tuple(o.q)) for o in message.observations if o.used]
        self.rejected = [
            np.array(o.q)
            for o in message.observations
            if not o.used and stamp_ns(o.end) >= self.progress.begun and np.isfinite(o.q).all()
        ]

    def on_maneuvers(self, message: Maneuvers) -> None:
        """Store the end and the rejection reason of the maneuvers received."""
        self.maneuvers = [(stamp_ns(m.end), "" if m.used else m.reason) for m in message.maneuvers]

    def on_result(self, message: Any) -> None:
        """Compare a calibration result with the goal."""
        result = calibration_part(message)
        self.result_stamp = stamp_ns(result.header.stamp)
        try:
            goal = parse_goal(self.settings.goal, result.names)
        except ValueError as error:
            raise SystemExit(str(error)) from None
        known = dict(zip(result.names, result.deviations, strict=False))
        promised = self.promised_deviations
        self.goal_met = result.verdict == PASS and all(known[k] <= x for k, x in goal.items())
        why = f" ({result.reason})" if result.verdict != PASS and result.reason else ""
        self.goal_status = f"{result.verdict}{why}, " + ", ".join(
            f"{name} ± {known[name]:.2g} (goal {limit:.2g}"
            + (f", promised {promised[name]:.2g})" if name in promised else ")")
            for name, limit in goal.items()
        )

    @property
    def waypoint(self) -> Waypoint:
        """Current stop, which the arm moves to or is at."""
        return self.way_back[0] if self.way_back else self.waypoints[self.progress.done]

    def tick(self) -> None:
        """Run the current phase, ten times per second."""
        self.send_keep_alive()
        now = self.now()
        if not now:
            return  # simulated time has not started
        if not self.progress.begun:
            self.progress.begun = now
            self.save()
        self.last_departure = self.last_departure or now
        topic = "maneuvers" if self.settings.maneuvers else "observations"
        self.is_observed = self.is_observed or bool(self.count_publishers(f"calibration/{topic}"))
        done = f"{self.progress.done} of {len(self.waypoints)} postures"
        if self.goal_met and self.at_rest:
            self.get_logger().info(f"goal met after {done}: {self.goal_status}")
            raise SystemExit(0)
        if self.progress.done < len(self.waypoints):
            self.phase(now)
        elif not self.repeat_rejected():
            self.finish(now)

    def finish(self, now: int) -> None:
        """Exit after the last posture, with failure if a goal is not met.

        If there is a goal, first wait until the calibration has used the last data.
        """
        s, waited = self.settings, now - self.last_departure
        ends = [end for end, _ in self.observed] + [end for end, why in self.maneuvers if not why]
        behind = self.result_stamp < max(ends, default=0)
        if s.goal and behind and 0 <= waited < s.observation_timeout * SECOND:
            self.log_change("waiting for the calibration")
            return
        self.get_logger().info(f"all {len(self.waypoints)} postures done")
        missed = f"goal not met: {self.goal_status or 'no calibration result received'}"
        raise SystemExit(missed if s.goal else 0)

    @property
    def at_rest(self) -> bool:
        """True if neither a move nor a maneuver is in progress."""
        before = self.waypoints[self.progress.done - 1] if self.progress.done else None
        moving = self.phase != self.request_move or bool(self.way_back)
        return not moving and (not before or before.pause != 0.0)

    def send_keep_alive(self) -> None:
        """Publish the keep-alive of the current move, or exit if this process was stalled."""
        before, self.last_tick = self.last_tick, time.monotonic()
        if before and (late := self.last_tick - before) > MAX_STALL:
            left = self.unfinished() or "at the end"
            raise SystemExit(f"this process was stalled for {late:.1f} s and exits {left}")
        if self.goal.done() and not self.outcome.done():
            self.keep_alive_publisher.publish(self.goal.result().goal_id)

    def unfinished(self) -> str:
        """Return the progress as text, or an empty string if all postures are done."""
        done, path = self.progress.done, self.settings.state_file
        later = f"resumes from {path}" if path else "starts over because state_file is not set"
        words = f"after {done} of {len(self.waypoints)} postures; the next run {later}"
        return words if done < len(self.waypoints) else ""

    def repeat_rejected(self) -> bool:
        """Append the postures of rejected rests; return True if there are any.

        The verdict of the calibration requires that these rests are repeated.
        """
        missing = [
            q
            for q in self.rejected
            if not any(
                np.abs(q - seen).max() <= self.settings.tolerance for _, seen in self.observed
            )
        ]
        if not missing or self.rounds >= MAX_REPEATS or self.settings.maneuvers:
            return False
        self.rounds += 1
        self.waypoints += [Waypoint(q) for q in missing]
        self.log_change(f"repeating rejected rests: {len(missing)}")
        return True

    def request_move(self, now: int) -> None:
        """Request the move to the next posture."""
        if not self.has_elapsed(now, self.settings.retry):
            return
        if not self.move_client.server_is_ready():
            self.log_change("waiting for arm/move")
            return
        q, duration, _ = self.waypoint
        goal = MoveArm.Goal(q=q.tolist(), duration=duration, keep_alive=self.settings.keep_alive)
        self.goal = self.move_client.send_goal_async(goal, feedback_callback=self.on_feedback)
        self.goal.add_done_callback(self.on_answer)
        self.outcome = Future()
        self.enter(self.await_result, now)

    def on_answer(self, answer: Future) -> None:
        """Wait for the result if the goal is accepted; retry if it is rejected."""
        if answer is self.goal and answer.result().accepted:
            self.outcome = answer.result().get_result_async()
        elif answer is self.goal:
            self.log_change("waiting to move: the goal was rejected; see the log of the node arm")
            self.enter(self.request_move, self.now())

    def on_feedback(self, _: Any) -> None:
        """Log the current move and reset its timeout."""
        if self.phase != self.await_result:
            return
        self.since = self.now()
        degrees = np.degrees(self.waypoint.q).round().astype(int)
        self.log_change(f"{self.title}: moving to {degrees.tolist()} degrees")

    def await_result(self, now: int) -> None:
        """Wait for the end of the move."""
        if self.outcome.done():
            result = self.outcome.result().result
            if result.reached:
                self.enter(self.await_observation, now)
            else:
                self.log_change(f"waiting to move: {result.message}")
                self.enter(self.request_move, now)
        elif self.has_elapsed(now, self.settings.silence):
            self.log_change("no feedback from arm/move: requesting the move again")
            self.enter(self.request_move, now)

    def await_observation(self, now: int) -> None:
        """Wait for the observation."""
        posture, _, pause = self.waypoint
        if pause >= 0.0:
            if self.has_elapsed(now, pause):
                self.finish_maneuver(now)
        elif any(
            end >= self.progress.begun and np.abs(posture - q).max() <= self.settings.tolerance
            for end, q in self.observed
        ):
            self.advance("observed")
        elif self.is_observed and self.has_elapsed(now, self.settings.observation_timeout):
            self.get_logger().warning(f"{self.title}: not observed")
            self.advance("continuing without an observation")
        elif not self.is_observed and self.has_elapsed(now, self.settings.rest):
            self.advance("done, no calibration node observes")

    def finish_maneuver(self, now: int) -> None:
        """Continue if the maneuver that ends here was observed; go back if it was rejected."""
        stop, first = self.waypoint, self.maneuver_start
        planned = stop.pause > 0.0 and self.progress.done > 0 and not self.way_back
        reasons = [reason for end, reason in self.maneuvers if end >= self.last_departure]
        if not planned or not self.is_observed or (reasons and not any(reasons)):
            self.advance("done")
        elif reasons and self.rounds < MAX_REPEATS:
            self.log_change(f"{self.title}: {max(reasons)}; returning to repeat it")
            self.way_back = return_waypoints(self.waypoints[first : self.progress.done + 1])
            self.rounds, self.progress.done, self.last_departure = self.rounds + 1, first + 1, now
            self.save()
            self.enter(self.request_move, 0)
        elif reasons or self.has_elapsed(now, stop.pause + self.settings.observation_timeout):
            self.get_logger().warning(f"{self.title}: not observed")
            self.advance("continuing without an observation")

    @property
    def maneuver_start(self) -> int:
        """Index of the posture where the current maneuver started: the last one with a pause."""
        return max((k for k in range(self.progress.done) if self.waypoints[k].pause), default=0)

    def advance(self, how: str) -> None:
        """Continue with the next posture."""
        self.log_change(f"{self.title}: {how}")
        if self.waypoint.pause:
            self.last_departure = self.now()
        if self.way_back:
            self.way_back.popleft()
        else:
            self.rounds = 0 if self.waypoint.pause > 0.0 else self.rounds
            self.progress.done += 1
        self.save()
        self.enter(self.request_move, 0)

    def enter(self, phase: Callable[[int], None], now: int) -> None:
        """Enter a phase; with now = 0, all its waiting times have already passed."""
        self.phase, self.since = phase, now

    def has_elapsed(self, now: int, seconds: float) -> bool:
        """Return True if the phase is older than `seconds`, or if time has jumped back."""
        return not 0 <= now - self.since < seconds * SECOND

    def now(self) -> int:
        """Return the time of the node's clock [ns]; 0 before simulated time starts."""
        return int(self.get_clock().now().nanoseconds)

    @property
    def title(self) -> str:
        """Text that names the current posture."""
        return f"posture {self.progress.done + 1} of {len(self.waypoints)}"

    def log_change(self, text: str) -> None:
        """Log a text if it differs from the last one."""
        if text != self.last_log:
            self.last_log = text
            self.get_logger().info(text)

    def health(self) -> Health:
        """Return the status for diagnostics."""
        trouble, values = self.writer.trouble, {"postures done": self.progress.done}
        return Health(WARN if trouble else OK, trouble or self.last_log or "starting", values)


def read_waypoints(settings: ExperimentSettings) -> list[Waypoint]:
    """Return the stops in order.

    Raises:
        ValueError: the stops do not match the arm, or a move between two of them is not clear.
        OSError: a file cannot be read.
    """
    s = settings
    arm = described(s.arm)
    if s.maneuvers:
        found = maneuver_waypoints(read_plan(s.maneuvers, arm.n), s.pause)
    elif len(s.postures) % arm.n:
        raise ValueError(f"postures has {len(s.postures)} numbers, expected {arm.n} a row")
    else:
        rows = (
            np.reshape(s.postures, (-1, arm.n))
            if s.postures
            else default_postures(arm, s.guarded())
        )
        found = [Waypoint(q) for q in rows]
    check_waypoints(np.array([stop.q for stop in found]).reshape(-1, arm.n), arm, s.guarded())
    return found


def maneuver_waypoints(plan: Sequence[Planned], pause: float) -> list[Waypoint]:
    """Return the stops of maneuvers, with a pause before the first and after each."""
    found = [Waypoint(plan[0].waypoints[0], 0.0, pause)] if plan else []
    for one in plan:
        moves = zip(one.waypoints[1:], one.durations.tolist(), strict=True)
        found += [Waypoint(q, duration, 0.0) for q, duration in moves]
        found[-1] = found[-1]._replace(pause=pause)
    return found


def return_waypoints(waypoints: Sequence[Waypoint]) -> deque[Waypoint]:
    """Return the stops of the way back, from the last to the first with the same durations."""
    found = deque(Waypoint(a.q, b.duration, 0.0) for a, b in pairwise(waypoints))
    found.reverse()
    found[-1] = found[-1]._replace(pause=waypoints[0].pause)
    return found


def check_waypoints(q: Floats, arm: Arm, guarded: GuardSettings) -> None:
    """Raise ValueError if a posture is beyond a limit, or a move between two is not clear."""
    for i, link in enumerate(arm.links):
        outside = (q[:, i] < link.q_min) | (q[:, i] > link.q_max) | ~np.isfinite(q[:, i])
        if outside.any():
            raise ValueError(
                f"postures: joint {i + 1} at {q[outside, i][0]:.4g} rad, "
                f"expected {link.q_min:.4g} to {link.q_max:.4g}"
            )
    guard = Guard(arm, guarded)
    for k in range(len(q)):
        try:
            guard.check_posture(q[k])
            guard.check_path((0.0, 1.0), q[[max(k - 1, 0), k]], np.zeros((2, arm.n)))
        except GuardError as error:
            raise ValueError(f"postures: on the way to posture {k + 1}, {error}") from None


if __name__ == "__main__":
    sys.exit(main())
