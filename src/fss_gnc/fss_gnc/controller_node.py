"""Node `controller`: runs a user's control law at a fixed rate, in a process of its own.

If the law fails or stalls, or base or joints are unknown, the valves close and the joints stop.
"""

import sys
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import MultiDOFJointTrajectory

from fss_arm_model.description_file import described
from fss_arm_msgs.msg import BaseTelemetry, LinkTelemetry, ThrusterHealth
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.events import log_event
from fss_arm_ros.libraries import require
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, command, sensor
from fss_arm_ros.timers import timer_clock
from fss_arm_ros.timing import MISSED, Timing
from fss_gnc import bounds, messages
from fss_gnc.latest_topics import LatestTopics
from fss_gnc.law import messages as law_messages
from fss_gnc.law.forms import EXPECTED
from fss_gnc.law.process import LawProcess
from fss_gnc.law.run import Command, LawRun
from fss_gnc.law.settings import ControllerSettings
from fss_gnc.law.snapshot import MAX_TRAJECTORY_AGE, Snapshot, world_covariance
from fss_gnc.programs import controller as main


class ControllerNode(Node):
    """Run a control law in Python, C, C++ or an FMU that commands base and arm."""

    def __init__(self, **options: Any) -> None:
        super().__init__("controller", **options)
        self.settings = s = declare(self, ControllerSettings)
        if not s.law:
            raise ValueError(f"law is '', expected {EXPECTED}")
        if s.law.endswith(".fmu"):
            require("fmpy")  # the law's process imports it
        self.arm, period = described(s.arm), 1.0 / s.rate
        self.snapshot, self.timing = Snapshot(self.arm.n, period), Timing(s.rate, self)
        self.topics = LatestTopics(self)
        self.subscribe()
        self.outputs = {
            topic: self.create_publisher(kind, topic, command(s.time_to_live))
            for topic, kind in law_messages.OUTPUT_TYPES.items()
        }
        self.gripper_closed: bool | None = None  # as last commanded
        self.armed = False  # whether the base's board was armed in the last step
        self.missed = 0  # deadlines missed before the last diagnostics
        self.process = LawProcess(s.law, self.arm.n, period)
        self.law = LawRun(self.process, self.arm.n, period, s.time_to_live)
        self.create_timer(period, self.tick, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health, timing=self.timing)
        self.get_logger().info(f"subscribed to base/state, with {s.law} (joints: {self.arm.n})")

    def subscribe(self) -> None:
        """Subscribe to the inputs of the law."""
        topics, shot = self.topics, self.snapshot
        topics.subscribe(Odometry, shot.base.name, self.on_base)
        topics.store(Odometry, shot.target, messages.body)
        topics.store(JointState, shot.joints, partial(messages.joints, n=self.arm.n))
        topics.store(BaseTelemetry, shot.valves_armed, lambda m: m.armed)
        for link in shot.links_armed:
            topics.store(LinkTelemetry, link, lambda m: m.armed)
        queue = sensor(best_effort=True)  # every message counts
        topics.subscribe(MultiDOFJointTrajectory, shot.trajectory.name, self.on_trajectory, queue)
        topics.subscribe(ThrusterHealth, "thrusters/health", self.on_valve_faults, LATCHED)
        topics.subscribe(Float64, "base/propellant", self.on_propellant)

    def now(self) -> int:
        """Return the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def on_base(self, message: Odometry) -> None:
        """Store state and covariance of the base."""
        body = messages.body(message)
        covariances = law_messages.planar_covariances(message)
        self.snapshot.covariance = world_covariance(*covariances, float(body.pose[2]))
        self.snapshot.base.store(stamp_ns(message.header.stamp), body)

    def on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        """Follow a new trajectory from now on; reject it if it is out of bounds."""
        now, stamp = self.now(), stamp_ns(message.header.stamp)
        path = messages.path(message)
        if path is not None:  # a message without points may always close the valves
            bounds.check_stamp(stamp, now, path.end_time, MAX_TRAJECTORY_AGE)
            bounds.check_reference(path, self.settings.table)
        self.snapshot.trajectory.store(now, (stamp, path))

    def on_valve_faults(self, message: ThrusterHealth) -> None:
        """Store which valves are stuck."""
        self.snapshot.health = law_messages.health(message)

    def on_propellant(self, message: Float64) -> None:
        """Store the remaining propellant; a sensor with an offset may report a negative mass."""
        self.snapshot.propellant = max(message.data, 0.0)

    def tick(self) -> None:
        """Run one step of the law, and publish its commands."""
        self.topics.poll()
        now, failed = self.now(), bool(self.law.failure)
        given = self.law.step(now, self.snapshot.at(now))
        if given:
            self.publish(given)
        if self.law.failure and not failed:
            self.report_failure()

    def publish(self, given: Command) -> None:
        """Publish commands; the gripper's only when it changes, and again after arming."""
        armed = bool(self.snapshot.valves_armed.valid_value(self.now()))
        if armed and not self.armed:
            self.gripper_closed = None  # the board has refused what came before
        self.armed = armed
        for topic, message in law_messages.output_messages(
            given, self.arm, self.settings.base_frame
        ):
            if topic == "gripper/command":
                if message.data == self.gripper_closed:
                    continue
                self.gripper_closed = message.data
            self.outputs[topic].publish(message)
        if given.is_stop:
            self.timing.interrupt()
        else:
            self.timing.add_step()
            self.timing.add_command(given.measured)

    def report_failure(self) -> None:
        """Log why the law has ended; end the node if the law has never run."""
        words = f"law {self.settings.law} has failed: {self.law.failure}"
        if not self.process.ready:
            raise SystemExit(words)
        words += f"; {self.law.describe_last(self.now())}; valves close and joints stop"
        words += "; restart the node controller to resume"
        self.get_logger().error(words)
        log_event(self, words)

    def health(self) -> Health:
        """Return the health for diagnostics."""
        law, s = self.law, self.settings
        missed, self.missed = law.missed - self.missed, law.missed
        values = {
            "law": s.law,
            "hash of its file": self.process.hash,
            "process": self.process.pid,
            "steps": law.steps,
            "expired outputs": law.expired,
            MISSED: law.missed,
        }
        if law.failure:
            return Health(ERROR, f"law has failed: {law.failure}", values)
        if law.is_starting:
            return Health(WARN, "law is starting", values)
        if problem := self.snapshot.problem(self.now()):
            return Health(WARN, f"valves closed, joints at rest: {problem}", values)
        if self.count_publishers("base/wrench") > 1:
            return Health(WARN, "base/wrench has another publisher; stop the node control", values)
        if missed:
            words = f"deadlines missed by the law since the last report: {missed}"
            return Health(WARN, words, values)
        return Health(OK, f"law is running{self.snapshot.disarmed(self.now())}", values)

    def close(self) -> None:
        """End the law; its last commands expire."""
        self.process.close()


if __name__ == "__main__":
    sys.exit(main())
