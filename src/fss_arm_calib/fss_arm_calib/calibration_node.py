"""Node for any kind of calibration: finds its data in live or replayed topics and solves."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node
from std_srvs.srv import Trigger

from fss_arm_calib.acceptance import PASS, format_count
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.node_settings import node_settings
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.streams import Streams, keep_newest
from fss_arm_calib.state import Flags, restore, save
from fss_arm_model.settings import default_in
from fss_arm_model.vehicle import Vehicle
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.libraries import require
from fss_arm_ros.memory import give_back
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.report import write
from fss_arm_ros.state_file import FileWriter, StateError
from fss_arm_ros.subscription_set import receive_pending
from fss_arm_ros.validation import subscribe

BASE = Vehicle.__dataclass_fields__["base_frame"]  # its default depends on the namespace


class CalibrationNode(Node):
    """Node that publishes its data and the resulting calibration whenever data are added.

    `~/solve` treats a rest or a motion in progress as finished, and solves. `~/forget` drops all
    data and resets the calibration.
    """

    def __init__(self, kind: Calibration[Any, Any], **options: Any) -> None:
        super().__init__(kind.name, **options)
        self.kind, self.writer = kind, FileWriter(self.get_logger())
        s = self.settings = declare(self, node_settings(kind.name, kind.settings))
        self.frame = s.frame_id or kind.frame or default_in(BASE, self.get_namespace())
        arm = load_described_arm(self, s.arm)
        # The described masses count as calibrated, so that a kinematic result keeps them.
        size = arm.vector().size
        self.initial = Calibrated(arm, dynamic=np.zeros((size, size)))
        restored, self.flags = restore(s.state_file, kind.name, arm.n, kind.data.type)
        self.data: list[Any] = keep_newest(restored, kind.max_data(s))
        self.count = len(restored)  # of data, for the log; a restart counts on from those saved
        self.finder = kind.finder(self.initial.arm, s, restored)
        try:
            self.outcome, self.saved = self.solve(), self.flags
            kind.data.to_message(self.data, self.frame)  # fail at startup if they are invalid
        except (ArithmeticError, LookupError, ValueError) as error:
            if not restored:
                raise
            raise StateError(f"{s.state_file}: the saved data cannot be solved: {error}") from error
        if s.report:
            require("matplotlib")
            kind.report_of(self.outcome)  # fail at startup if the report's inputs are missing
        self.data_publisher = self.create_publisher(kind.data.message, kind.data.topic, LATCHED)
        self.result_publisher = self.create_publisher(kind.message, kind.topic, LATCHED)
        for one in kind.inputs(s, self.initial.arm.n):
            source = self, one.message, one.topic, partial(self.on_sample, one.feed)
            if one.latched:
                subscribe(*source, LATCHED, one.rule)
            else:
                subscribe_sensor(*source, keep_all=True)
        for topic, message in kind.prior_results.items():
            subscribe(self, message, topic, partial(self.on_result, topic), LATCHED)
        self.create_service(Trigger, "~/solve", self.on_solve)
        self.create_service(Trigger, "~/forget", self.on_forget)
        self.get_logger().info(kind.describe_start(s, arm.n, len(restored)))
        if restored:
            self.publish()
        self.diagnostics = Diagnostics(self, self.health)

    def on_sample(self, feed: Callable[[Any, Any], Sequence[Any]], message: Any) -> None:
        """Feed a sensor message to the finder."""
        self.add_data(feed(self.finder, message))

    def on_result(self, topic: str, message: Any) -> None:
        """Replace the initial guess by the result of another calibration, with its covariance."""
        try:
            initial = self.initial.of_same_links(topic, message)
        except ValueError as error:
            self.get_logger().warning(f"result on {topic} rejected: {error}")
            return
        if initial.arm != self.initial.arm:
            self.initial = initial
            self.get_logger().info(f"initial guess replaced by the result on {topic}")
            self.outcome = self.solve()
            self.publish()

    def on_solve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Solve from all data received; succeed if the calibration passes."""
        receive_pending(self)
        if not self.add_data(self.finder.close()):
            self.outcome = self.solve()
            self.publish()
        if folder := self.settings.report:
            self.writer(lambda: write(folder, self.kind.report_of(self.outcome)))
        response.success = self.outcome.verdict == PASS
        response.message = self.kind.describe(self.outcome, self.streams())
        return response

    def on_forget(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Drop all data received, also in the state file, and reset the state of the streams."""
        receive_pending(self)
        words = f"{format_count(len(self.data), self.kind.data.noun)} forgotten"
        response.success, response.message = True, words
        self.get_logger().info(words)
        self.data, self.count, self.flags = [], 0, Flags()
        self.finder = self.kind.finder(self.initial.arm, self.settings, [])
        self.outcome = self.solve()
        self.publish()
        return response

    def add_data(self, found: Sequence[Any]) -> bool:
        """Store, save and publish new data and solve again; return False if there are none."""
        if found:
            max_data = self.kind.max_data(self.settings)
            first = 1 if self.kind.data.is_replaced else self.count + 1
            self.count += len(found)
            self.data = keep_newest([*self.data, *found], max_data)
            self.outcome = self.solve()
            self.publish()
            lines = [self.kind.data.describe(one, k) for k, one in enumerate(found, first)]
            for line in (*lines, f"{self.outcome.verdict}: {self.outcome.summary}"):
                self.get_logger().info(line)
        return bool(found)

    def streams(self) -> Streams:
        """Return the state of the streams, including previous runs."""
        return self.flags.and_then(self.finder.streams())

    def solve(self) -> Outcome[Any, Any]:
        """Solve the calibration from all data; look for the cause if it does not pass."""
        found = self.kind.solve(self.data, self.initial.arm, self.settings, self.streams())
        give_back()
        return found

    def publish(self) -> None:
        """Save and publish the data and the calibration; write the output if it passes."""
        kind, s = self.kind, self.settings
        self.writer.trouble = ""
        self.save()
        self.data_publisher.publish(kind.data.to_message(self.data, self.frame))
        self.result_publisher.publish(kind.to_message(self.outcome, self.frame))
        if s.output and self.outcome.verdict == PASS:
            self.writer(lambda: kind.write(s.output, self.outcome))

    def save(self) -> None:
        """Save data and flags for the next run."""
        self.saved = Flags.of(self.streams())
        if path := self.settings.state_file:
            name, n = self.kind.name, self.initial.arm.n
            self.writer(partial(save, path, name, n, self.data, self.saved))

    def health(self) -> Health:
        """Return the state of the node for diagnostics."""
        kind, streams = self.kind, self.streams()
        flags = Flags.of(streams)
        if (flags.unknown, flags.set_back) != (self.saved.unknown, self.saved.set_back):
            self.save()  # no further datum may arrive to trigger it
        values = {
            f"{kind.data.noun}s": len(self.data),
            "verdict": self.outcome.verdict,
            "time offset [s]": kind.unavailable.get("time offset", streams.offset.value),
            **kind.health(self.finder),
            **{f"rejected: {why}": number for why, number in streams.rejected.items()},
        }
        if self.writer.trouble:
            return Health(ERROR, self.writer.trouble, values)
        if problem := kind.problem(self.outcome, streams, self.settings):
            return Health(WARN, problem, values)
        return Health(OK, format_count(len(self.outcome.used), kind.data.noun), values)
