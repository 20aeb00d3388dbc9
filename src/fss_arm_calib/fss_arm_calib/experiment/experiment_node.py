"""Node `experiment`: moves the arm through postures to be observed, or through maneuvers."""

import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.experiment.sequencer import Progress, Seen, Sequencer
from fss_arm_calib.experiment.settings import ExperimentSettings
from fss_arm_calib.experiment.waypoints import read_waypoints
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.messages import calibration_part
from fss_arm_calib.programs import experiment as main
from fss_arm_model.files import read_yaml
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import KinematicObservations, Maneuvers
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.events import report
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.state_file import FileWriter, StateError, read, write
from fss_arm_ros.validation import subscribe

MAX_STALL = 2.0  # longest tolerated stall of this process [s]; then only the operator may resume


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
        waypoints = read_waypoints(s, load_described_arm(self, s.arm))
        plan: Any = read_yaml(Path(s.maneuvers)) if s.maneuvers else {}
        self.writer = FileWriter(self.get_logger())
        self.saved = self.restore()
        self.sequencer = Sequencer(s, waypoints, self.saved)
        self.sequencer.promised = plan.get("promised", {})
        self.move_client = ActionClient(self, MoveArm, "arm/move")
        self.keep_alive_publisher = self.create_publisher(UUID, "arm/move/alive", 10)
        self.last_tick = 0.0  # real time of the last tick [s]
        self.goal, self.outcome = Future(), Future()  # of the last move requested
        for kind, callback in (KINEMATIC, self.on_observations), (DYNAMIC, self.on_maneuvers):
            data = kind.data
            subscribe(self, data.message, data.topic, callback, LATCHED, data.rule)
        self.kind = DYNAMIC if s.maneuvers else KINEMATIC
        if s.goal:
            subscribe(self, self.kind.message, self.kind.topic, self.on_result, LATCHED)
        self.create_timer(0.05, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health)

    def restore(self) -> Progress:
        """Read the progress of a previous run."""
        path = self.settings.state_file
        try:
            progress = Progress(**read(path, {})) if path else Progress()
        except TypeError as error:
            problem = f"{path} does not contain the progress of an experiment: {error}"
            raise StateError(problem) from None
        if progress.done:
            self.get_logger().info(f"resuming after {progress.done} postures")
        return progress

    def on_observations(self, message: KinematicObservations) -> None:
        """Store the rests received."""
        self.sequencer.rests = [
            Seen(stamp_ns(o.end), o.used, o.reason, np.array(o.q)) for o in message.observations
        ]

    def on_maneuvers(self, message: Maneuvers) -> None:
        """Store the end and the rejection reason of the maneuvers received."""
        self.sequencer.maneuvers = [
            Seen(stamp_ns(m.end), m.used, m.reason) for m in message.maneuvers
        ]

    def on_result(self, message: Any) -> None:
        """Compare a calibration result with the goal."""
        found = calibration_part(message)
        deviations = dict(zip(found.names, found.deviations, strict=False))
        stamp = stamp_ns(found.header.stamp)
        try:
            self.sequencer.compare_with_goal(stamp, found.verdict, found.reason, deviations)
        except ValueError as error:
            raise SystemExit(str(error)) from None

    def tick(self) -> None:
        """Run the experiment, twenty times per second."""
        self.send_keep_alive()
        now = self.now()
        if not now:
            return  # simulated time has not started
        sequencer, outcome = self.sequencer, self.outcome
        sequencer.is_observed |= self.count_publishers(self.kind.data.topic) > 0
        result = outcome.result().result if outcome.done() else None
        if sequencer.step(now, self.move_client.server_is_ready(), result):
            self.request_move()
        self.report_progress()
        if sequencer.exit_code is not None:
            raise SystemExit(sequencer.exit_code)

    def report_progress(self) -> None:
        """Log the lines of the sequencer; save its progress for a later run if it has changed."""
        lines, self.sequencer.lines = self.sequencer.lines, []
        report(self, lines)
        if self.sequencer.progress == self.saved:
            return
        self.saved = self.sequencer.progress
        if path := self.settings.state_file:
            self.writer.trouble = ""
            self.writer(lambda: write(path, asdict(self.saved)))

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
        return self.sequencer.unfinished

    def request_move(self) -> None:
        """Request the move to the next posture."""
        q, duration, *_ = self.sequencer.waypoint
        goal = MoveArm.Goal(q=q.tolist(), duration=duration, keep_alive=self.settings.keep_alive)
        self.goal = self.move_client.send_goal_async(goal, feedback_callback=self.on_feedback)
        self.goal.add_done_callback(self.on_answer)
        self.outcome = Future()

    def on_answer(self, answer: Future) -> None:
        """Wait for the result if the goal is accepted; retry if it is rejected."""
        if answer is self.goal and answer.result().accepted:
            self.outcome = answer.result().get_result_async()
        elif answer is self.goal:
            self.sequencer.reject_move(self.now())
            self.report_progress()

    def on_feedback(self, _: Any) -> None:
        """Log the current move and reset its timeout."""
        self.sequencer.receive_feedback(self.now())
        self.report_progress()

    def now(self) -> int:
        """Return the time of the node's clock [ns]; 0 before simulated time starts."""
        return int(self.get_clock().now().nanoseconds)

    def health(self) -> Health:
        """Return the status for diagnostics."""
        trouble, values = self.writer.trouble, {"postures done": self.sequencer.progress.done}
        status = trouble or self.sequencer.status or "starting"
        return Health(WARN if trouble else OK, status, values)


if __name__ == "__main__":
    sys.exit(main())
