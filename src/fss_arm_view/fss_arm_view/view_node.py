"""Node `view`: displays the test bed, live or replayed, in rerun."""

import os
import socket
import sys
import time
from collections import Counter, defaultdict, deque
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from math import degrees, dist, inf, isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from fss_arm_model.description_file import described
from fss_arm_msgs.msg import (
    BaseReaction,
    BaseTelemetry,
    DynamicCalibration,
    GripperState,
    KinematicCalibration,
    LinkTelemetry,
    MissionState,
    ThrusterCommand,
)
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import SECOND, joint_readings, seen_pose, stamp_ns
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, sensor
from fss_arm_ros.stamps import Stamps
from fss_arm_ros.validation import subscribe

from . import scene
from .programs import view as main
from .settings import ViewSettings
from .sink import (
    FILE,
    NATIVE,
    WEB,
    Sink,
    VehicleSink,
    Viewer,
    disable_analytics,
    host,
    new_file,
    open_stream,
)
from .strip import Strip, to_json

MIN_PLUME_DURATION = 0.2  # for which a thruster pulse is drawn [s]

MAX_PREDICTION_AGE = 3 * SECOND  # of a predicted base that is drawn [ns]
MISSION_TIMEOUT = 2 * SECOND  # time for which a mission's message is valid [ns]
STATUS_PERIOD = 0.5  # at which the page's strip is updated [s]

LEVELS = {OK: "INFO", WARN: "WARN", ERROR: "ERROR"}


class ViewNode(Node):
    """Node that displays one vehicle; `owner` has the viewer and draws what all vehicles share."""

    def __init__(self, owner: "ViewNode | None" = None, **options: Any) -> None:
        super().__init__("view", **options)
        s = self.settings = declare(self, ViewSettings)
        self.owner = owner or self  # node that owns the viewer
        self.vehicle = self.get_namespace().strip("/") if owner else ""
        self.vehicle_nodes: list[ViewNode] = []
        self.calibrated = Calibrated(described(s.arm))
        self.config_folder: TemporaryDirectory[str] = (
            owner.config_folder if owner else disable_analytics()
        )
        self.viewer = None
        if s.mode in (NATIVE, WEB) and not owner:
            ports = s.port, s.web_port
            self.viewer = Viewer(s.mode, s.bind, *ports, s.memory, s.names, self.status_file)
        self.sink: Sink | VehicleSink = (
            VehicleSink(owner.sink, self.vehicle)
            if owner
            else Sink(self._recording(), s.rate, s.queue)
        )
        self.q = [0.0] * self.calibrated.arm.n
        self.strip, self.received = Strip(), time.monotonic()  # time of the last measurement [s]
        self.t = 0  # stamp of the newest measurement [ns]; 0: none yet
        self.outlines: dict[str, MarkerArray] = {}  # newest message of each topic
        self.reported: Counter[str] = Counter()  # the sink's counts when last reported
        self.sequences: dict[int, int] = {}
        self.losses: dict[int, float] = {}
        self.logged_levels: dict[str, bytes] = {}
        self.reset()
        self._subscribe()
        if owner:
            owner.vehicle_nodes.append(self)
            return
        subscribe(
            self, DiagnosticArray, "/diagnostics", self.on_diagnostics, sensor(best_effort=True)
        )
        if s.mode == WEB:
            self._log_address()
        self.diagnostics = Diagnostics(self, self.health)
        if s.mode == WEB:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(STATUS_PERIOD, self.write_status, clock=steady)

    @property
    def status_file(self) -> Path:
        """File from which the gate answers the page's requests."""
        return Path(self.config_folder.name) / "now.json"

    def write_status(self) -> None:
        """Write the content of the page's strip to the file that the gate reads."""
        now, nodes = time.monotonic(), self.vehicle_nodes or [self]
        strips = {node.vehicle: node.strip.items(now) for node in nodes}
        newest = max(nodes, key=lambda node: node.received)
        text = to_json(newest.t, now - newest.received, strips)
        fresh = self.status_file.with_suffix(".new")
        fresh.write_text(text)
        fresh.replace(self.status_file)

    def _recording(self) -> rr.RecordingStream:
        s = self.settings
        target = self.viewer.url if self.viewer else s.url
        if s.mode == FILE:
            target = new_file(s.file)
            self.get_logger().info(f"writing {target}")
        return open_stream(s.mode, target, scene.blueprint())

    def reset(self) -> None:
        """Draw the static parts, and reset everything measured."""
        self.sink.enqueue(
            None, [*scene.static_scene(), *scene.series_styles(self.calibrated.arm.n, self.vehicle)]
        )
        self.legend = [text for text, _ in scene.LEGEND]
        self.stamps: dict[str, Stamps] = defaultdict(Stamps)  # by stream
        self.valves_until = [0] * 8
        self.mission, self.path, self.keep_out = "", list[tuple[float, float]](), 0.0
        # Stamps of the newest pose when a mission, its path, and any path were received [ns].
        self.mission_time = self.mission_path_time = self.path_time = -MISSION_TIMEOUT
        self.difference: npt.NDArray[np.float64] | None = None  # measured minus predicted base
        self.difference_valid_until = 0  # time after which it is too old to be drawn [ns]
        self.trails: dict[str, deque[tuple[float, float]]] = {
            what: deque(maxlen=scene.MAX_TRAIL_POINTS)
            for what in ("tip_path", "com_path", "base_path")
        }
        for topic, message in self.outlines.items():
            self.on_outlines(topic, message)

    def _subscribe(self) -> None:
        s, best_effort = self.settings, sensor(best_effort=True)
        for kind, topic, callback in (
            (JointState, s.joints_topic, self.on_joints),
            (PoseStamped, s.base_topic, self.on_base),
            (PoseStamped, s.tip_topic, self.on_tip),
            (PoseStamped, s.target_topic, self.on_target),
            (ThrusterCommand, "thrusters/command", self.on_thrust),
            (ThrusterCommand, "thrusters/pulses", self.on_thrust),
            (MissionState, "mission/state", self.on_mission),
            (MultiDOFJointTrajectory, "base/trajectory", self.on_trajectory),
            (BaseReaction, "base_reaction", self.on_reaction),
        ):
            subscribe(self, kind, topic, callback, best_effort)
        for kind, topic, callback in (
            (BaseTelemetry, "base/telemetry", partial(setattr, self.strip, "base")),
            (GripperState, "gripper/state", partial(setattr, self.strip, "gripper")),
            (Float64, "base/propellant", self.on_propellant),
        ):
            subscribe(self, kind, topic, callback, best_effort)
        for i in range(1, self.calibrated.arm.n + 1):
            subscribe(self, LinkTelemetry, f"link_{i}/telemetry", self.on_telemetry, best_effort)
        subscribe(self, Empty, "arm/stop", self.on_stop, 10)
        for kind, topic in (
            (KinematicCalibration, "calibration/kinematic"),
            (DynamicCalibration, "calibration/dynamic"),
        ):
            subscribe(self, kind, topic, partial(self.on_calibration, topic), LATCHED)
        for topic in s.outline_topics:
            callback = partial(self.on_outlines, topic)
            subscribe(self, MarkerArray, topic, callback, LATCHED)

    def _log_address(self) -> None:
        s, log = self.settings, self.get_logger()
        name = host(s.bind, socket.gethostname())
        log.info(f"open http://{name}:{s.web_port}/?url=rerun%2Bhttp://{name}:{s.port}/proxy")
        if not ip_address(s.bind).is_loopback:
            log.warning(
                f"{name}:{s.port} has no authentication: all who reach it can change the view"
            )

    def on_measurement(self, stream: str, message: Any) -> int:
        """Return a measurement's stamp [ns]; it is the time of all events until the next one.

        Stamps of events may come from another clock, for example during a replay or simulation.
        A viewer stays at the newest time of a recording. So if stamps jump back, a new recording
        is started.
        """
        self.t, self.received = stamp_ns(message.header.stamp), time.monotonic()
        if self.stamps[stream].set_back(self.t):
            self.sink.stream = self.owner._recording()
            for node in (self.owner, *self.owner.vehicle_nodes):
                node.reset()
        return self.t

    def on_joints(self, message: JointState) -> None:
        """Store and plot the readings of one or more links."""
        t = self.on_measurement("joints", message)
        drawings = []
        for i, q, _, effort in joint_readings(message):
            if 1 <= i <= self.calibrated.arm.n and isfinite(q):
                self.q[i - 1] = q
                if self.sink.due(f"joint {i}"):
                    angle = scene.link_value("angle", i, degrees(q))
                    drawings += [angle, scene.link_value("effort", i, effort)]
        if drawings:
            self.sink.enqueue(t, drawings)

    def on_base(self, message: PoseStamped) -> None:
        """Draw the base, and the whole arm, at a measured pose."""
        self.on_measurement("base", message)
        if self.sink.due("base") and (pose := seen_pose(message)):
            valves = [self.t < until for until in self.valves_until]
            parts = [scene.plumes(pose, valves), *scene.arm(self.calibrated.arm, pose, self.q)]
            if self.difference is not None and self.t < self.difference_valid_until:
                parts.append(scene.base(pose - self.difference, scene.PREDICTED_COLOR))
            parts.append(scene.base(pose, scene.MEASURED_COLOR))
            if self.path and self.t < self.path_time + MISSION_TIMEOUT:
                parts.append(scene.route([pose[:2], *self.path]))
            named = [scene.name_label(pose, self.vehicle)] if self.vehicle else []
            self.sink.enqueue(
                self.t, [scene.combine("arm", parts), scene.base_transform(pose), *named]
            )
            if self.t > self.mission_time + MISSION_TIMEOUT:
                self.set_mission_text("")
            self.extend_trail(self.t, "base_path", pose[:2], scene.MEASURED_COLOR)

    def on_tip(self, message: PoseStamped) -> None:
        """Extend the path of the end effector."""
        if self.sink.due("tip") and (pose := seen_pose(message)):
            self.extend_trail(stamp_ns(message.header.stamp), "tip_path", pose[:2], scene.TIP_COLOR)

    def on_target(self, message: PoseStamped) -> None:
        """Draw the target, and the circle to keep out of."""
        if self.sink.due("target") and (pose := seen_pose(message)):
            self.add_to_legend("target", scene.TARGET_COLOR)
            parts = [scene.base(pose, scene.TARGET_COLOR)]
            if self.keep_out > 0.0 and self.t < self.mission_time + MISSION_TIMEOUT:
                parts.append(scene.circle(pose[:2], self.keep_out, scene.TARGET_COLOR))
            self.sink.enqueue(stamp_ns(message.header.stamp), [scene.combine("target", parts)])

    def on_mission(self, message: MissionState) -> None:
        """Store the mission's phase, path and keep-out radius."""
        self.mission_time = self.t
        self.keep_out = message.keep_out if isfinite(message.keep_out) else 0.0
        if message.path:
            self.mission_path_time = self.t
            self.set_path(zip(message.path[::3], message.path[1::3], strict=False))
        text = f"{message.mission}: {message.phase}" if message.mission else ""
        text += f", {message.reason}" if message.reason else ""
        self.set_mission_text(text, "WARN" if message.reason else "INFO")

    def on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        """Store the base's planned path, unless a mission has published its own path."""
        if self.t > self.mission_path_time + MISSION_TIMEOUT:
            poses = [point.transforms[0] for point in message.points if point.transforms]
            self.set_path((pose.translation.x, pose.translation.y) for pose in poses)

    def set_mission_text(self, text: str, level: str = "INFO") -> None:
        """Draw and log the mission's state, if it has changed."""
        if text != self.mission:
            self.mission = text
            self.sink.enqueue(self.t, [scene.phase_label(text)])
            self.log_event(text or "no mission", level)

    def set_path(self, points: Iterable[tuple[float, float]]) -> None:
        """Store the planned path of the base, to be drawn with its next pose."""
        self.path = [(x, y) for x, y in points if isfinite(x) and isfinite(y)]
        self.path_time = self.t
        self.add_to_legend("path planned", scene.PREDICTED_COLOR)

    def on_thrust(self, message: ThrusterCommand) -> None:
        """Set the times until which the plumes of the thrusters are drawn."""
        self.add_to_legend("thrusters", scene.THRUST_COLOR)
        for k, seconds in enumerate(message.on_time):
            shown = max(seconds, MIN_PLUME_DURATION) if 0.0 < seconds < inf else 0.0
            self.valves_until[k] = self.t + int(shown * SECOND)

    def on_propellant(self, message: Float64) -> None:
        """Store the mass of the remaining gas [kg]."""
        self.strip.propellant = message.data

    def on_reaction(self, message: BaseReaction) -> None:
        """Plot prediction and measurement of the base's motion."""
        sigma = float(message.predicted_deviation[2])
        self.strip.heading_difference = float(message.difference[2]), sigma
        if self.sink.due("reaction"):
            # Telemetry is older than the base's poses: draw the prediction from the newest pose.
            is_known = np.isfinite(message.difference).all()  # NaN once thrusters have fired
            self.difference = np.array(message.difference) if is_known else None
            t = stamp_ns(message.header.stamp)
            self.difference_valid_until = t + MAX_PREDICTION_AGE
            self.sink.enqueue(t, scene.reaction_drawings(message))
            self.extend_trail(t, "com_path", tuple(message.com), scene.PREDICTED_COLOR)

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """Plot one link's current, and the share of its frames that were lost."""
        self.strip.links[message.link] = message, time.monotonic()
        i, missed = message.link, message.sequence - self.sequences.get(message.link, -1) - 1
        share = missed / (missed + 1) if i in self.sequences and missed >= 0 else 0.0
        self.losses[i] = 0.95 * self.losses.get(i, 0.0) + 0.05 * share
        self.sequences[i] = message.sequence
        if self.sink.due(f"current {i}"):
            current = scene.link_value("current", i, 0.01 * message.current)
            loss = scene.link_value("loss", i, 100.0 * self.losses[i])
            self.sink.enqueue(stamp_ns(message.header.stamp), [current, loss])

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Log each node's state when it changes."""
        for status in message.status:
            self.update_node_errors(status)
            if self.logged_levels.get(status.name) != status.level:
                self.logged_levels[status.name] = status.level
                self.log_event(f"{status.name}: {status.message}", LEVELS.get(status.level, "WARN"))

    def update_node_errors(self, status: DiagnosticStatus) -> None:
        """Add a node's error to its vehicle's strip, or remove it when the error is over."""
        space = f"/{status.name.strip('/')}".rpartition("/")[0].strip("/")
        for node in self.vehicle_nodes or [self]:
            if node.vehicle in ("", space):
                node.strip.node_errors.pop(status.name, None)
                if status.level == ERROR:
                    node.strip.node_errors[status.name] = status.message

    def on_stop(self, _: Empty) -> None:
        """Log that arm/stop was received."""
        self.log_event("arm/stop", "ERROR")

    def on_calibration(self, topic: str, message: Any) -> None:
        """Log a calibration's verdict; if it passed, draw the arm with it."""
        with suppress(ValueError):  # base_reaction reports the error
            self.calibrated = self.calibrated.of_same_links(topic, message)
        calibration = message.calibration
        self.strip.verdicts[topic.rpartition("/")[2]] = calibration.verdict
        level = "INFO" if calibration.verdict == calibration.PASS else "WARN"
        text = f"{topic.rpartition('/')[2]}: {calibration.verdict}: {calibration.reason}"
        self.log_event(text, level)

    def on_outlines(self, topic: str, message: MarkerArray) -> None:
        """Draw boundaries of the workspace by name; new names are added to the legend."""
        self.outlines[topic] = message
        lines = [marker for marker in message.markers if marker.type == Marker.LINE_STRIP]
        for name in dict.fromkeys(marker.ns for marker in lines):
            outline = [marker for marker in lines if marker.ns == name]
            header, c = outline[0].header, outline[0].color
            color = round(255 * c.r), round(255 * c.g), round(255 * c.b)
            strips = [[(p.x, p.y) for p in marker.points] for marker in outline]
            in_base = header.frame_id == self.settings.base_frame
            self.sink.enqueue(self.t, scene.outline(strips, name, color, in_base))
            self.add_to_legend(name, color)

    def extend_trail(
        self, t: int, what: str, point: tuple[float, float], color: tuple[int, int, int]
    ) -> None:
        """Extend a path if the point has moved."""
        trail = self.trails[what]
        if not trail or dist(trail[-1], point) > scene.MIN_TRAIL_STEP:
            trail.append(point)
            self.sink.enqueue(t, [scene.trail(trail, what, color)])

    def add_to_legend(self, name: str, color: tuple[int, int, int]) -> None:
        """Add a new name to the legend."""
        legend = self.owner.legend
        if name not in legend:
            self.sink.enqueue(None, [scene.legend_entry(len(legend), name, color)])
            legend.append(name)

    def log_event(self, text: str, level: str) -> None:
        """Add a line to the view's log."""
        text = f"{self.vehicle}: {text}" if self.vehicle else text
        self.sink.enqueue(self.t, [scene.log_line(text, level)])

    def health(self) -> Health:
        """Return the node's health for diagnostics."""
        now, before = Counter(self.sink.counts), self.reported
        self.reported = now
        if self.viewer and not self.viewer.is_running():
            return Health(ERROR, "the viewer has stopped; restart this node", now)
        if now["dropped"] > before["dropped"] and now["shown"] == before["shown"]:
            return Health(WARN, "the viewer accepts no drawings", now)
        return Health(OK, f"running in mode {self.settings.mode}", now)

    def close(self) -> None:
        """Write the waiting drawings and stop the viewer."""
        self.sink.close()
        if self.viewer:
            self.viewer.close()
        if self.owner is self:
            self.config_folder.cleanup()


def make_nodes() -> list[ViewNode]:
    """Display joints, base, end effector, base reaction, verdicts and faults.

    The node subscribes best effort and never waits for the viewer, so that it does not delay other
    nodes. In mode web, open the address that it logs in a browser.
    """
    # Node and viewer run only when the processor is idle, so that drivers never wait for them.
    with suppress(OSError):  # a container may forbid this
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    return create_nodes()


def create_nodes() -> list[ViewNode]:
    """Return the node and one further node in its process for each vehicle that it displays."""
    owner = ViewNode()
    return [owner, *(ViewNode(owner, namespace=name) for name in owner.settings.vehicles)]


if __name__ == "__main__":
    sys.exit(main())
