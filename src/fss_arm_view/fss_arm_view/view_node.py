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
from .sink import FILE, NATIVE, WEB, Scoped, Sink, Viewer, host, keep_quiet, new_file, open_stream
from .strip import Strip, told

LEAST_PLUME = 0.2  # minimum time for which a thruster pulse is drawn [s]

OLD = 3 * SECOND  # age of a prediction after which its ghost is no longer drawn
LIVES = 2 * SECOND  # time for which a mission's message is valid
TELLS = 0.5  # period at which the page's strip is updated [s]

LEVELS = {OK: "INFO", WARN: "WARN", ERROR: "ERROR"}


class ViewNode(Node):
    """Node that displays one vehicle; `first` owns the viewer and draws what all vehicles share."""

    def __init__(self, first: "ViewNode | None" = None, **options: Any) -> None:
        super().__init__("view", **options)
        s = self.settings = declare(self, ViewSettings)
        self.first = first or self  # node whose viewer also displays this vehicle
        self.vehicle = self.get_namespace().strip("/") if first else ""
        self.others: list[ViewNode] = []
        self.known = Calibrated(described(s.arm))
        self.quiet: TemporaryDirectory[str] = first.quiet if first else keep_quiet()
        self.viewer = None
        if s.mode in (NATIVE, WEB) and not first:
            ports = s.port, s.web_port
            self.viewer = Viewer(s.mode, s.bind, *ports, s.memory, s.names, self.said_to_page)
        self.sink: Sink | Scoped = (
            Scoped(first.sink, self.vehicle) if first else Sink(self._recording(), s.rate, s.queue)
        )
        self.q = [0.0] * self.known.arm.n
        self.strip, self.heard = Strip(), time.monotonic()  # last measurement received at [s]
        self.t = 0  # stamp of the newest measurement [ns]; 0: none yet
        self.outlines: dict[str, MarkerArray] = {}  # newest message of each topic
        self.reported: Counter[str] = Counter()  # the sink's counts when last reported
        self.sequences: dict[int, int] = {}
        self.losses: dict[int, float] = {}
        self.said: dict[str, bytes] = {}
        self.begin()
        self._listen()
        if first:
            first.others.append(self)
            return
        subscribe(
            self, DiagnosticArray, "/diagnostics", self.on_diagnostics, sensor(best_effort=True)
        )
        if s.mode == WEB:
            self._say_where()
        self.diagnostics = Diagnostics(self, self.health)
        if s.mode == WEB:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(TELLS, self.tell_page, clock=steady)

    @property
    def said_to_page(self) -> Path:
        """File from which the gate answers the page's requests."""
        return Path(self.quiet.name) / "now.json"

    def tell_page(self) -> None:
        """Write the content of the page's strip to the file that the gate reads."""
        now, ones = time.monotonic(), self.others or [self]
        strips = {one.vehicle: one.strip.items(now) for one in ones}
        newest = max(ones, key=lambda one: one.heard)
        text = told(newest.t, now - newest.heard, strips)
        fresh = self.said_to_page.with_suffix(".new")
        fresh.write_text(text)
        fresh.replace(self.said_to_page)

    def _recording(self) -> rr.RecordingStream:
        s = self.settings
        target = self.viewer.url if self.viewer else s.url
        if s.mode == FILE:
            target = new_file(s.file)
            self.get_logger().info(f"writes {target}")
        return open_stream(s.mode, target, scene.blueprint())

    def begin(self) -> None:
        """Draw what does not change, and reset everything measured."""
        self.sink.put(None, [*scene.ground(), *scene.styles(self.known.arm.n, self.vehicle)])
        self.legend = [text for text, _ in scene.LEGEND]
        self.stamps: dict[str, Stamps] = defaultdict(Stamps)  # by stream
        self.valves_until = [0] * 8
        self.mission, self.path, self.keep_out = "", list[tuple[float, float]](), 0.0
        # Stamps of the newest pose when a mission, its path, and any path were received [ns].
        self.told = self.routed = self.planned = -LIVES
        self.difference: npt.NDArray[np.float64] | None = None  # measured minus predicted base
        self.differs_until = 0  # time after which it is too old to be drawn [ns]
        self.trails: dict[str, deque[tuple[float, float]]] = {
            what: deque(maxlen=scene.TRAIL) for what in ("tip_path", "com_path", "base_path")
        }
        for topic, message in self.outlines.items():
            self.on_outlines(topic, message)

    def _listen(self) -> None:
        s, quick = self.settings, sensor(best_effort=True)
        for kind, topic, take in (
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
            subscribe(self, kind, topic, take, quick)
        for kind, topic, take in (
            (BaseTelemetry, "base/telemetry", partial(setattr, self.strip, "base")),
            (GripperState, "gripper/state", partial(setattr, self.strip, "gripper")),
            (Float64, "base/propellant", self.on_propellant),
        ):
            subscribe(self, kind, topic, take, quick)
        for i in range(1, self.known.arm.n + 1):
            subscribe(self, LinkTelemetry, f"link_{i}/telemetry", self.on_telemetry, quick)
        subscribe(self, Empty, "arm/stop", self.on_stop, 10)
        for of, topic in (
            (KinematicCalibration, "calibration/kinematic"),
            (DynamicCalibration, "calibration/dynamic"),
        ):
            subscribe(self, of, topic, partial(self.on_calibration, topic), LATCHED)
        for topic in s.outline_topics:
            take = partial(self.on_outlines, topic)
            subscribe(self, MarkerArray, topic, take, LATCHED)

    def _say_where(self) -> None:
        s, log = self.settings, self.get_logger()
        name = host(s.bind, socket.gethostname())
        log.info(f"open http://{name}:{s.web_port}/?url=rerun%2Bhttp://{name}:{s.port}/proxy")
        if not ip_address(s.bind).is_loopback:
            log.warning(f"whoever reaches {name}:{s.port} may read and write: no authentication")

    def measured(self, stream: str, message: Any) -> int:
        """Return a measurement's stamp [ns]; it is the time of all events until the next one.

        Stamps of events may come from another clock, for example during a replay or simulation.
        A viewer stays at the newest time of a recording. So if stamps jump back, a new recording
        is started.
        """
        self.t, self.heard = stamp_ns(message.header.stamp), time.monotonic()
        if self.stamps[stream].set_back(self.t):
            self.sink.stream = self.first._recording()
            for one in (self.first, *self.first.others):
                one.begin()
        return self.t

    def on_joints(self, message: JointState) -> None:
        """Store and plot the readings of one or more links."""
        t = self.measured("joints", message)
        drawings = []
        for i, q, _, effort in joint_readings(message):
            if 1 <= i <= self.known.arm.n and isfinite(q):
                self.q[i - 1] = q
                if self.sink.due(f"joint {i}"):
                    angle = scene.link("angle", i, degrees(q))
                    drawings += [angle, scene.link("effort", i, effort)]
        if drawings:
            self.sink.put(t, drawings)

    def on_base(self, message: PoseStamped) -> None:
        """Draw the base, and the whole arm, at a measured pose."""
        self.measured("base", message)
        if self.sink.due("base") and (pose := seen_pose(message)):
            valves = [self.t < until for until in self.valves_until]
            parts = [scene.plumes(pose, valves), *scene.arm(self.known.arm, pose, self.q)]
            if self.difference is not None and self.t < self.differs_until:
                parts.append(scene.base(pose - self.difference, scene.GHOST))
            parts.append(scene.base(pose, scene.STEEL))
            if self.path and self.t < self.planned + LIVES:
                parts.append(scene.route([pose[:2], *self.path]))
            named = [scene.called(pose, self.vehicle)] if self.vehicle else []
            self.sink.put(self.t, [scene.together("arm", parts), scene.place(pose), *named])
            if self.t > self.told + LIVES:
                self.entitle("")
            self.trace(self.t, "base_path", pose[:2], scene.STEEL)

    def on_tip(self, message: PoseStamped) -> None:
        """Extend the path of the end effector."""
        if self.sink.due("tip") and (pose := seen_pose(message)):
            self.trace(stamp_ns(message.header.stamp), "tip_path", pose[:2], scene.TIP)

    def on_target(self, message: PoseStamped) -> None:
        """Draw the target, and the circle to keep out of."""
        if self.sink.due("target") and (pose := seen_pose(message)):
            self.explain("target", scene.PURPLE)
            parts = [scene.base(pose, scene.PURPLE)]
            if self.keep_out > 0.0 and self.t < self.told + LIVES:
                parts.append(scene.circle(pose[:2], self.keep_out, scene.PURPLE))
            self.sink.put(stamp_ns(message.header.stamp), [scene.together("target", parts)])

    def on_mission(self, message: MissionState) -> None:
        """Store the mission's phase, path and keep-out radius."""
        self.told, self.keep_out = self.t, message.keep_out if isfinite(message.keep_out) else 0.0
        if message.path:
            self.routed = self.t
            self.plan(zip(message.path[::3], message.path[1::3], strict=False))
        words = f"{message.mission}: {message.phase}" if message.mission else ""
        words += f", {message.reason}" if message.reason else ""
        self.entitle(words, "WARN" if message.reason else "INFO")

    def on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        """Store the base's planned path, unless a mission has published its own path."""
        if self.t > self.routed + LIVES:
            poses = [point.transforms[0] for point in message.points if point.transforms]
            self.plan((pose.translation.x, pose.translation.y) for pose in poses)

    def entitle(self, words: str, level: str = "INFO") -> None:
        """Draw and log the mission's state, if it has changed."""
        if words != self.mission:
            self.mission = words
            self.sink.put(self.t, [scene.phase(words)])
            self.say(words or "no mission", level)

    def plan(self, points: Iterable[tuple[float, float]]) -> None:
        """Store the planned path of the base, to be drawn with its next pose."""
        self.path = [(x, y) for x, y in points if isfinite(x) and isfinite(y)]
        self.planned = self.t
        self.explain("path planned", scene.GHOST)

    def on_thrust(self, message: ThrusterCommand) -> None:
        """Set the times until which the plumes of the thrusters are drawn."""
        self.explain("thrusters", scene.JET)
        for k, seconds in enumerate(message.on_time):
            shown = max(seconds, LEAST_PLUME) if 0.0 < seconds < inf else 0.0
            self.valves_until[k] = self.t + int(shown * SECOND)

    def on_propellant(self, message: Float64) -> None:
        """Store the mass of the remaining gas [kg]."""
        self.strip.propellant = message.data

    def on_reaction(self, message: BaseReaction) -> None:
        """Plot prediction and measurement of the base's motion."""
        self.strip.turn = float(message.difference[2]), float(message.predicted_deviation[2])
        if self.sink.due("reaction"):
            # Telemetry is older than the base's poses: the ghost is drawn relative to the newest.
            known = np.isfinite(message.difference).all()  # NaN once thrusters have fired
            self.difference = np.array(message.difference) if known else None
            t = stamp_ns(message.header.stamp)
            self.differs_until = t + OLD
            self.sink.put(t, scene.reaction(message))
            self.trace(t, "com_path", tuple(message.com), scene.GHOST)

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """Plot one link's current, and the share of its frames that were lost."""
        self.strip.links[message.link] = message, time.monotonic()
        i, missed = message.link, message.sequence - self.sequences.get(message.link, -1) - 1
        share = missed / (missed + 1) if i in self.sequences and missed >= 0 else 0.0
        self.losses[i] = 0.95 * self.losses.get(i, 0.0) + 0.05 * share
        self.sequences[i] = message.sequence
        if self.sink.due(f"current {i}"):
            current = scene.link("current", i, 0.01 * message.current)
            loss = scene.link("loss", i, 100.0 * self.losses[i])
            self.sink.put(stamp_ns(message.header.stamp), [current, loss])

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Log each node's state when it changes."""
        for status in message.status:
            self.trouble(status)
            if self.said.get(status.name) != status.level:
                self.said[status.name] = status.level
                self.say(f"{status.name}: {status.message}", LEVELS.get(status.level, "WARN"))

    def trouble(self, status: DiagnosticStatus) -> None:
        """Add a node's error to its vehicle's strip, or remove it when the error is over."""
        space = f"/{status.name.strip('/')}".rpartition("/")[0].strip("/")
        for one in self.others or [self]:
            if one.vehicle in ("", space):
                one.strip.troubles.pop(status.name, None)
                if status.level == ERROR:
                    one.strip.troubles[status.name] = status.message

    def on_stop(self, _: Empty) -> None:
        """Log that arm/stop was received."""
        self.say("arm/stop", "ERROR")

    def on_calibration(self, topic: str, message: Any) -> None:
        """Log a calibration's verdict; if it passed, draw the arm with it."""
        with suppress(ValueError):  # base_reaction reports the error
            self.known = self.known.of_same_links(topic, message)
        found = message.calibration
        self.strip.verdicts[topic.rpartition("/")[2]] = found.verdict
        level = "INFO" if found.verdict == found.PASS else "WARN"
        text = f"{topic.rpartition('/')[2]}: {found.verdict}: {found.reason}"
        self.say(text, level)

    def on_outlines(self, topic: str, message: MarkerArray) -> None:
        """Draw boundaries of the workspace by name; new names are added to the legend."""
        self.outlines[topic] = message
        lines = [marker for marker in message.markers if marker.type == Marker.LINE_STRIP]
        for name in dict.fromkeys(marker.ns for marker in lines):
            those = [marker for marker in lines if marker.ns == name]
            header, c = those[0].header, those[0].color
            colour = round(255 * c.r), round(255 * c.g), round(255 * c.b)
            strips = [[(p.x, p.y) for p in marker.points] for marker in those]
            in_base = header.frame_id == self.settings.base_frame
            self.sink.put(self.t, scene.outline(strips, name, colour, in_base))
            self.explain(name, colour)

    def trace(
        self, t: int, what: str, point: tuple[float, float], colour: tuple[int, int, int]
    ) -> None:
        """Extend a path if the point has moved."""
        trail = self.trails[what]
        if not trail or dist(trail[-1], point) > scene.TRAIL_STEP:
            trail.append(point)
            self.sink.put(t, [scene.trail(trail, what, colour)])

    def explain(self, name: str, colour: tuple[int, int, int]) -> None:
        """Add a new name to the legend."""
        legend = self.first.legend
        if name not in legend:
            self.sink.put(None, [scene.legend(len(legend), name, colour)])
            legend.append(name)

    def say(self, text: str, level: str) -> None:
        """Add a line to the view's log."""
        words = f"{self.vehicle}: {text}" if self.vehicle else text
        self.sink.put(self.t, [scene.words(words, level)])

    def health(self) -> Health:
        """Return the node's health for diagnostics."""
        now, before = Counter(self.sink.counts), self.reported
        self.reported = now
        if self.viewer and not self.viewer.alive():
            return Health(ERROR, "the viewer has ended", now)
        if now["dropped"] > before["dropped"] and now["shown"] == before["shown"]:
            return Health(WARN, "the viewer takes no drawings", now)
        return Health(OK, f"shows in mode {self.settings.mode}", now)

    def close(self) -> None:
        """Write the waiting drawings and stop the viewer."""
        self.sink.close()
        if self.viewer:
            self.viewer.close()
        if self.first is self:
            self.quiet.cleanup()


def make_nodes() -> list[ViewNode]:
    """Display joints, base, end effector, base reaction, verdicts and faults.

    The node subscribes best effort and never waits for the viewer, so that it does not delay other
    nodes. In mode web, open the address that it logs in a browser.
    """
    # Node and viewer run only when the processor is idle, so that drivers never wait for them.
    with suppress(OSError):  # a container may forbid this
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    return views()


def views() -> list[ViewNode]:
    """Return the node and one further node in its process for each vehicle that it displays."""
    first = ViewNode()
    return [first, *(ViewNode(first, namespace=name) for name in first.settings.vehicles)]


if __name__ == "__main__":
    sys.exit(main())
