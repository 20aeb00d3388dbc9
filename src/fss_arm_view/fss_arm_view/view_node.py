"""The node `view`: the test bed, live or replayed, in rerun."""

import sys
from collections import deque
from functools import partial
from math import degrees
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from fss_arm_model.description import from_yaml, load, paper_arm
from fss_arm_msgs.msg import BaseReaction, KinematicCalibration, LinkTelemetry
from fss_arm_ros.convert import PoseError, planar_pose, stamp_ns
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.qos import LATCHED, sensor
from fss_arm_ros.run import run
from fss_arm_ros.settings import declare

from . import scene
from .settings import ViewSettings
from .sink import CONNECT, FILE, NATIVE, WEB, Sink, Viewer, open_stream

LEVELS = {OK: "INFO", WARN: "WARN", ERROR: "ERROR"}


class ViewNode(Node):
    """Shows joints, base, end effector, base reaction, verdicts and faults.

    It subscribes best effort and never waits for the viewer, so that it holds nobody up. In mode
    web, open http://127.0.0.1:9090/?url=rerun%2Bhttp://127.0.0.1:9876/proxy in a browser.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("view", **options)
        s = self.settings = declare(self, ViewSettings)
        self.arm = load(s.arm) if s.arm else paper_arm()
        self.viewer = None
        if s.mode in (NATIVE, WEB):
            self.viewer = Viewer(s.mode, s.bind, s.port, s.web_port, s.memory)
        here = f"rerun+http://127.0.0.1:{s.port}/proxy"
        target = {FILE: s.file, CONNECT: s.url}.get(s.mode, here)
        self.sink = Sink(open_stream(s.mode, target, scene.blueprint()), s.rate, s.queue)
        self.q = [0.0] * self.arm.n
        self.t = 0
        self.trails: dict[str, deque[tuple[float, float]]] = {
            what: deque(maxlen=scene.TRAIL) for what in ("tip_path", "com_path")
        }
        self.sequences: dict[int, int] = {}
        self.losses: dict[int, float] = {}
        self.said: dict[str, bytes] = {}
        self.sink.put(None, [*scene.ground(), *scene.styles(self.arm.n)])
        self._listen()
        if s.mode == WEB:
            self._say_where()
        self.diagnostics = Diagnostics(self, self.health)

    def _listen(self) -> None:
        s, quick = self.settings, sensor(best_effort=True)
        for kind, topic, take in (
            (JointState, s.joints_topic, self.on_joints),
            (PoseStamped, s.base_topic, self.on_base),
            (PoseStamped, s.tip_topic, self.on_tip),
            (PoseStamped, s.target_topic, self.on_target),
            (BaseReaction, "base_reaction", self.on_reaction),
            (DiagnosticArray, "/diagnostics", self.on_diagnostics),
        ):
            self.create_subscription(kind, topic, take, quick)
        for i in range(1, self.arm.n + 1):
            self.create_subscription(LinkTelemetry, f"link_{i}/telemetry", self.on_telemetry, quick)
        self.create_subscription(Empty, "arm/stop", self.on_stop, 10)
        self.create_subscription(
            KinematicCalibration, "calibration/kinematic", self.on_calibration, LATCHED
        )
        for topic in s.boundaries:
            self.create_subscription(
                PolygonStamped, topic, partial(self.on_boundary, topic), LATCHED
            )

    def _say_where(self) -> None:
        s, log = self.settings, self.get_logger()
        page = f"http://{s.bind}:{s.web_port}/?url=rerun%2Bhttp://{s.bind}:{s.port}/proxy"
        log.info(f"open {page}")
        if s.bind not in ("127.0.0.1", "localhost", "::1"):
            log.warning(f"whoever reaches {s.bind}:{s.port} may read and write: no authentication")

    def on_joints(self, message: JointState) -> None:
        """Readings of one link or more."""
        t = stamp_ns(message.header.stamp)
        drawings = []
        for name, q, effort in zip(message.name, message.position, message.effort, strict=True):
            i = int(name.rpartition("_")[2])
            if 1 <= i <= self.arm.n:
                self.q[i - 1] = q
                if self.sink.due(name):
                    drawings += [
                        scene.link("angle", i, degrees(q)), scene.link("effort", i, effort),
                    ]  # fmt: skip
        if drawings:
            self.sink.put(t, drawings)

    def on_base(self, message: PoseStamped) -> None:
        """A pose of the base: the whole arm is drawn with it."""
        self.t = stamp_ns(message.header.stamp)
        if self.sink.due("base") and (pose := _pose(message)):
            base = scene.base(pose, "base", scene.STEEL)
            self.sink.put(self.t, [base, *scene.arm(self.arm, pose, self.q)])

    def on_tip(self, message: PoseStamped) -> None:
        """A pose of the end effector: its path."""
        if self.sink.due("tip") and (pose := _pose(message)):
            self.trails["tip_path"].append(pose[:2])
            path = scene.trail(self.trails["tip_path"], "tip_path", scene.TIP)
            self.sink.put(stamp_ns(message.header.stamp), [path])

    def on_target(self, message: PoseStamped) -> None:
        """A pose of the target."""
        if self.sink.due("target") and (pose := _pose(message)):
            self.sink.put(stamp_ns(message.header.stamp), [scene.base(pose, "target", scene.MARK)])

    def on_reaction(self, message: BaseReaction) -> None:
        """Prediction and measurement of the base's motion."""
        if self.sink.due("reaction"):
            self.trails["com_path"].append(tuple(message.com))
            path = scene.trail(self.trails["com_path"], "com_path", scene.GHOST)
            self.sink.put(stamp_ns(message.header.stamp), [*scene.reaction(message), path])

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """One link's current, and the share of its frames that did not come."""
        i, missed = message.link, message.sequence - self.sequences.get(message.link, -1) - 1
        share = missed / (missed + 1) if i in self.sequences and missed >= 0 else 0.0
        self.losses[i] = 0.95 * self.losses.get(i, 0.0) + 0.05 * share
        self.sequences[i] = message.sequence
        if self.sink.due(f"current {i}"):
            current = scene.link("current", i, 0.01 * message.current)
            loss = scene.link("loss", i, 100.0 * self.losses[i])
            self.sink.put(stamp_ns(message.header.stamp), [current, loss])

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Each node's state when it changes."""
        t = stamp_ns(message.header.stamp)
        for status in message.status:
            if self.said.get(status.name) != status.level:
                self.said[status.name] = status.level
                self.say(t, f"{status.name}: {status.message}", LEVELS.get(status.level, "WARN"))

    def on_stop(self, _: Empty) -> None:
        """Somebody stopped the arm."""
        self.say(self.t, "arm/stop", "ERROR")

    def on_calibration(self, message: KinematicCalibration) -> None:
        """A verdict; the arm is drawn with a calibration that passed."""
        if message.verdict == KinematicCalibration.PASS:
            self.arm = from_yaml(message.description)
        level = "INFO" if message.verdict == KinematicCalibration.PASS else "WARN"
        self.say(
            stamp_ns(message.header.stamp), f"kinematic: {message.verdict}: {message.reason}", level
        )

    def on_boundary(self, topic: str, message: PolygonStamped) -> None:
        """A boundary of the workspace."""
        points = [(p.x, p.y) for p in message.polygon.points]
        if points:
            what = f"boundary/{topic.rpartition('/')[2]}"
            self.sink.put(stamp_ns(message.header.stamp), [scene.boundary(points, what)])

    def say(self, t: int, text: str, level: str) -> None:
        """A line in the view's log."""
        self.sink.put(t, [scene.words(text, level)])

    def health(self) -> Health:
        """For diagnostics."""
        if self.viewer and not self.viewer.alive():
            return Health(ERROR, "the viewer has ended", self.sink.counts)
        return Health(OK, f"shows in mode {self.settings.mode}", self.sink.counts)

    def close(self) -> None:
        """Write what waits and end the viewer."""
        self.sink.close()
        if self.viewer:
            self.viewer.close()


def _pose(message: PoseStamped) -> tuple[float, float, float] | None:
    """The pose; None while the subject is occluded."""
    try:
        return planar_pose(message.pose)
    except PoseError:
        return None


def main() -> int:
    """Run as `ros2 run fss_arm_view view`."""
    return run(ViewNode, ViewSettings)


if __name__ == "__main__":
    sys.exit(main())
