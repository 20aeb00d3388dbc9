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
        self.stops = read_waypoints(s)
        plan: Any = read_yaml(Path(s.maneuvers)) if s.maneuvers else {}
        self.promised = plan.get("promised", {})  # deviations, by name
        self.writes = state.FileWriter(self.get_logger())
        self.progress = self.restore()
        self.progress.done = min(self.progress.done, len(self.stops))  # without repeated rests
        self.mover = ActionClient(self, MoveArm, "arm/move")
        self.alive = self.create_publisher(UUID, "arm/move/alive", 10)
        self.ticked = 0.0  # real time of the last tick [s]
        self.observed: list[tuple[int, tuple[float, ...]]] = []  # end [ns], readings [rad]
        self.rejected: list[Floats] = []  # readings [rad]
        self.rounds = 0  # repeats of all rejected rests, or of the current maneuver
        self.observer = False  # True once a calibration node publishes observations
        self.seen: list[tuple[int, str]] = []  # end [ns] and rejection reason of each maneuver
        self.departed = 0  # end of the last pause, or start of the experiment [ns]
        self.reached = ""  # text with the deviations of the goal's parameters
        self.met = False  # True if the goal is met
        self.solved = 0  # stamp of the last calibration result: end of its data [ns]
        self.way_back: deque[Waypoint] = deque()  # back to the start of a maneuver to repeat
        subscribe(
            self, KinematicObservations, "calibration/observations", self.on_observations, LATCHED
        )
        subscribe(self, Maneuvers, "calibration/maneuvers", self.on_maneuvers, LATCHED)
        if s.goal:
            kind = DynamicCalibration if s.maneuvers else KinematicCalibration
            topic = f"calibration/{'dynamic' if s.maneuvers else 'kinematic'}"
            subscribe(self, kind, topic, self.on_result, LATCHED)
        self.phase: Callable[[int], None] = self.go
        self.since = 0  # start of the phase, or last feedback in it [ns]
        self.goal, self.outcome = Future(), Future()
        self.said = ""
        self.create_timer(0.1, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health)

    def restore(self) -> Progress:
        """Read the progress of a previous run."""
        path = self.settings.state_file
        try:
            progress = Progress(**state.read(path, {})) if path else Progress()
        except TypeError as error:
            raise state.StateError(f"{path} holds no progress: {error}") from None
        if progress.done:
            self.get_logger().info(f"goes on after {progress.done} postures")
        return progress

    def save(self) -> None:
        """Save the progress for a later run."""
        if path := self.settings.state_file:
            self.writes.trouble = ""
            self.writes(lambda: state.write(path, asdict(self.progress)))

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
        self.seen = [(stamp_ns(m.end), "" if m.used else m.reason) for m in message.maneuvers]

    def on_result(self, message: Any) -> None:
        """Compare a calibration result with the goal."""
        result = calibration_part(message)
        self.solved = stamp_ns(result.header.stamp)
        try:
            goal = parse_goal(self.settings.goal, result.names)
        except ValueError as error:
            raise SystemExit(str(error)) from None
        known = dict(zip(result.names, result.deviations, strict=False))
        self.met = result.verdict == PASS and all(known[k] <= x for k, x in goal.items())
        why = f" ({result.reason})" if result.verdict != PASS and result.reason else ""
        self.reached = f"{result.verdict}{why}, " + ", ".join(
            f"{name} ± {known[name]:.2g} (asked {asked:.2g}"
            + (f", promised {self.promised[name]:.2g})" if name in self.promised else ")")
            for name, asked in goal.items()
        )

    @property
    def stop(self) -> Waypoint:
        """Current stop, which the arm moves to or is at."""
        return self.way_back[0] if self.way_back else self.stops[self.progress.done]

    def tick(self) -> None:
        """Run the current phase, ten times per second."""
        self.show_life()
        now = self.now()
        if not now:
            return  # simulated time has not started
        if not self.progress.begun:
            self.progress.begun = now
            self.save()
        self.departed = self.departed or now
        topic = "maneuvers" if self.settings.maneuvers else "observations"
        self.observer = self.observer or bool(self.count_publishers(f"calibration/{topic}"))
        done = f"{self.progress.done} of {len(self.stops)} postures"
        if self.met and self.at_rest:
            self.get_logger().info(f"goal met after {done}: {self.reached}")
            raise SystemExit(0)
        if self.progress.done < len(self.stops):
            self.phase(now)
        elif not self.repeat():
            self.end(now)

    def end(self, now: int) -> None:
        """Exit after the last posture, with failure if a goal is not met.

        If there is a goal, first wait until the calibration has used the last data.
        """
        s, waited = self.settings, now - self.departed
        ends = [end for end, _ in self.observed] + [end for end, why in self.seen if not why]
        behind = self.solved < max(ends, default=0)
        if s.goal and behind and 0 <= waited < s.observation_timeout * SECOND:
            self.say("waiting for the calibration")
            return
        self.get_logger().info(f"all {len(self.stops)} postures done")
        missed = f"goal not met: {self.reached or 'no calibration told its deviations'}"
        raise SystemExit(missed if s.goal else 0)

    @property
    def at_rest(self) -> bool:
        """True if neither a move nor a maneuver is in progress."""
        before = self.stops[self.progress.done - 1] if self.progress.done else None
        return self.phase == self.go and not self.way_back and (not before or before.pause != 0.0)

    def show_life(self) -> None:
        """Publish the keep-alive of the current move, or exit if this process was stalled."""
        before, self.ticked = self.ticked, time.monotonic()
        if before and (late := self.ticked - before) > MAX_STALL:
            left = self.unfinished() or "at the end"
            raise SystemExit(f"this program stood still for {late:.1f} s, {left}; not going on")
        if self.goal.done() and not self.outcome.done():
            self.alive.publish(self.goal.result().goal_id)

    def unfinished(self) -> str:
        """Return the progress as text, or an empty string if all postures are done."""
        done, path = self.progress.done, self.settings.state_file
        later = f"goes on from {path}" if path else "begins anew, as there is no state_file"
        words = f"after {done} of {len(self.stops)} postures; the next run {later}"
        return words if done < len(self.stops) else ""

    def repeat(self) -> bool:
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
        self.stops += [Waypoint(q) for q in missing]
        self.say(f"repeating rejected rests: {len(missing)}")
        return True

    def go(self, now: int) -> None:
        """Request the move to the next posture."""
        if not self.waited(now, self.settings.retry):
            return
        if not self.mover.server_is_ready():
            self.say("waiting for arm/move")
            return
        q, duration, _ = self.stop
        goal = MoveArm.Goal(q=q.tolist(), duration=duration, keep_alive=self.settings.keep_alive)
        self.goal = self.mover.send_goal_async(goal, feedback_callback=self.on_feedback)
        self.goal.add_done_callback(self.on_answer)
        self.outcome = Future()
        self.enter(self.move, now)

    def on_answer(self, answer: Future) -> None:
        """Wait for the result if the goal is accepted; retry if it is rejected."""
        if answer is self.goal and answer.result().accepted:
            self.outcome = answer.result().get_result_async()
        elif answer is self.goal:
            self.say("waiting to move: the goal was rejected; the log of the node arm says why")
            self.enter(self.go, self.now())

    def on_feedback(self, _: Any) -> None:
        """Log the current move and reset its timeout."""
        if self.phase != self.move:
            return
        self.since = self.now()
        degrees = np.degrees(self.stop.q).round().astype(int)
        self.say(f"{self.title}: moving to {degrees.tolist()} degrees")

    def move(self, now: int) -> None:
        """Wait for the end of the move."""
        if self.outcome.done():
            result = self.outcome.result().result
            if result.reached:
                self.enter(self.watch, now)
            else:
                self.say(f"waiting to move: {result.message}")
                self.enter(self.go, now)
        elif self.waited(now, self.settings.silence):
            self.say("the move is lost, asking again")
            self.enter(self.go, now)

    def watch(self, now: int) -> None:
        """Wait for the observation."""
        posture, _, pause = self.stop
        if pause >= 0.0:
            if self.waited(now, pause):
                self.conclude(now)
        elif any(
            end >= self.progress.begun and np.abs(posture - q).max() <= self.settings.tolerance
            for end, q in self.observed
        ):
            self.leave("observed")
        elif self.observer and self.waited(now, self.settings.observation_timeout):
            self.get_logger().warning(f"{self.title}: not observed")
            self.leave("left")
        elif not self.observer and self.waited(now, self.settings.rest):
            self.leave("done, nobody observes")

    def conclude(self, now: int) -> None:
        """Continue if the maneuver that ends here was observed; go back if it was rejected."""
        stop, first = self.stop, self.began
        planned = stop.pause > 0.0 and self.progress.done > 0 and not self.way_back
        reasons = [reason for end, reason in self.seen if end >= self.departed]
        if not planned or not self.observer or (reasons and not any(reasons)):
            self.leave("done")
        elif reasons and self.rounds < MAX_REPEATS:
            self.say(f"{self.title}: {max(reasons)}, so going back to repeat it")
            self.way_back = return_waypoints(self.stops[first : self.progress.done + 1])
            self.rounds, self.progress.done, self.departed = self.rounds + 1, first + 1, now
            self.save()
            self.enter(self.go, 0)
        elif reasons or self.waited(now, stop.pause + self.settings.observation_timeout):
            self.get_logger().warning(f"{self.title}: not observed")
            self.leave("left")

    @property
    def began(self) -> int:
        """Index of the posture where the current maneuver started: the last one with a pause."""
        return max((k for k in range(self.progress.done) if self.stops[k].pause), default=0)

    def leave(self, how: str) -> None:
        """Continue with the next posture."""
        self.say(f"{self.title}: {how}")
        if self.stop.pause:
            self.departed = self.now()
        if self.way_back:
            self.way_back.popleft()
        else:
            self.rounds = 0 if self.stop.pause > 0.0 else self.rounds
            self.progress.done += 1
        self.save()
        self.enter(self.go, 0)

    def enter(self, phase: Callable[[int], None], now: int) -> None:
        """Enter a phase; with now = 0, all its waiting times have already passed."""
        self.phase, self.since = phase, now

    def waited(self, now: int, seconds: float) -> bool:
        """Return True if the phase is older than `seconds`, or if time has jumped back."""
        return not 0 <= now - self.since < seconds * SECOND

    def now(self) -> int:
        """Return the time of the node's clock [ns]; 0 before simulated time starts."""
        return int(self.get_clock().now().nanoseconds)

    @property
    def title(self) -> str:
        """Text that names the current posture."""
        return f"posture {self.progress.done + 1} of {len(self.stops)}"

    def say(self, text: str) -> None:
        """Log a text if it differs from the last one."""
        if text != self.said:
            self.said = text
            self.get_logger().info(text)

    def health(self) -> Health:
        """Return the status for diagnostics."""
        trouble, values = self.writes.trouble, {"postures done": self.progress.done}
        return Health(WARN if trouble else OK, trouble or self.said or "starting", values)


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
