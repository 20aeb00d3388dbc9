"""Topics of one vehicle of the view: messages in, drawings out."""

import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from math import degrees, hypot, isfinite
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

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
from fss_arm_ros.convert import joint_readings, seen_pose, stamp_ns
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.qos import LATCHED, sensor
from fss_arm_ros.stamps import Stamps
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.validation import subscribe

from . import scene
from .live import vehicle_state
from .settings import ViewSettings
from .sink import Sink, VehicleSink
from .strip import BASE, GRIPPER, HEADING, PROPELLANT, Strip
from .vehicle_scene import FrameLoss, VehicleScene


class VehicleTopics:
    """Subscriptions to the topics of one vehicle.

    Args:
        node: node in the vehicle's namespace.
        settings: parameters of the node.
        sink: receives the drawings.
        legend: legend of all vehicles.
        restart: starts a new recording, and resets all vehicles.
        name: name of the vehicle; empty if it is the only one.
    """

    def __init__(
        self,
        node: Node,
        settings: ViewSettings,
        sink: Sink | VehicleSink,
        legend: scene.Legend,
        restart: Callable[[], None],
        name: str = "",
    ) -> None:
        self.settings, self.sink, self.legend = settings, sink, legend
        self.restart, self.name = restart, name
        self.calibrated = Calibrated(load_described_arm(node, settings.arm))
        self.scene = VehicleScene(self.calibrated.arm, name)
        self.strip = Strip(self.scene.arm.n)
        self.received = time.monotonic()  # time of the last measurement [s]
        self.t = 0  # stamp of the newest measurement [ns]; 0: none yet
        self.outlines: dict[str, MarkerArray] = {}  # newest message of each topic
        self.losses: dict[int, FrameLoss] = defaultdict(FrameLoss)  # by link
        self.reset()
        self._subscribe(node)

    def reset(self) -> None:
        """Draw the static parts, and reset everything measured."""
        styles = scene.series_styles(self.scene.arm.n, self.name)
        self.sink.enqueue(None, [*scene.static_scene(), *styles])
        self.stamps: dict[str, Stamps] = defaultdict(Stamps)  # by stream
        self.scene.reset()
        for topic, message in self.outlines.items():
            self.on_outlines(topic, message)

    def _subscribe(self, node: Node) -> None:
        s, n = self.settings, self.scene.arm.n
        sensors: list[tuple[type, str, Callable[[Any], None]]] = [
            (JointState, "joint_states", self.on_joints),
            (ThrusterCommand, "thrusters/command", self.on_thrust),
            (ThrusterCommand, "thrusters/pulses", self.on_thrust),
            (MissionState, "mission/state", self.on_mission),
            (MultiDOFJointTrajectory, "base/trajectory", self.on_trajectory),
            (BaseReaction, "base_reaction", self.on_reaction),
            (BaseTelemetry, "base/telemetry", partial(self.store, BASE)),
            (GripperState, "gripper/state", partial(self.store, GRIPPER)),
            (Float64, "base/propellant", self.on_propellant),
            *((LinkTelemetry, f"link_{i}/telemetry", self.on_telemetry) for i in range(1, n + 1)),
        ]
        poses: list[tuple[type, str, Callable[[Any], None]]] = [
            (PoseStamped, s.base_topic, self.on_base),
            (PoseStamped, s.tip_topic, self.on_tip),
            (PoseStamped, s.target_topic, self.on_target),
        ]
        # Polled, so that hundreds of messages per second do not wake the node one by one.
        every = sensor(best_effort=True)
        self.polled = [PolledSubscription(node, *one, every) for one in sensors]
        self.polled += [PolledSubscription(node, *one) for one in poses]
        subscribe(node, Empty, "arm/stop", self.on_stop, 10)
        for kind, topic in (
            (KinematicCalibration, "calibration/kinematic"),
            (DynamicCalibration, "calibration/dynamic"),
        ):
            subscribe(node, kind, topic, partial(self.on_calibration, topic), LATCHED)
        for topic in s.outline_topics:
            subscribe(node, MarkerArray, topic, partial(self.on_outlines, topic), LATCHED)

    def poll(self) -> None:
        """Handle the messages that have arrived; of each pose only the newest."""
        for subscription in self.polled:
            subscription.poll()

    def state(self, now: float) -> dict[str, Any]:
        """Return what the page draws at time `now` of a monotonic clock [s]."""
        return vehicle_state(self.scene, self.t, self.strip.items(now), self.name)

    def on_measurement(self, stream: str, message: Any) -> int:
        """Return a measurement's stamp [ns]; it is the time of all events until the next one.

        Stamps of events may come from another clock, for example during a replay or simulation.
        A viewer stays at the newest time of a recording. So if stamps jump back, a new recording
        is started.
        """
        self.t, self.received = stamp_ns(message.header.stamp), time.monotonic()
        if self.stamps[stream].set_back(self.t):
            self.restart()
        return self.t

    def on_joints(self, message: JointState) -> None:
        """Store and plot the readings of one or more links."""
        t = self.on_measurement("joints", message)
        drawings = []
        for i, q, _, effort in joint_readings(message):
            if 1 <= i <= self.scene.arm.n and isfinite(q):
                self.scene.q[i - 1] = q
                if self.sink.due(f"joint {i}"):
                    angle = scene.link_value("angle", i, degrees(q))
                    drawings += [angle, scene.link_value("effort", i, effort)]
        if drawings:
            self.sink.enqueue(t, drawings)

    def on_base(self, message: PoseStamped) -> None:
        """Draw the base, and the whole arm, at a measured pose."""
        t = self.on_measurement("base", message)
        if not (pose := seen_pose(message)):
            return
        self.scene.pose, self.strip.pose_received = pose, self.received
        if self.sink.due("base"):
            self.sink.enqueue(t, self.scene.draw_base(t, pose))
            if self.scene.mission.is_over(t):
                self.set_mission_text("")

    def on_tip(self, message: PoseStamped) -> None:
        """Extend the path of the end effector."""
        if not (pose := seen_pose(message)):
            return
        self.scene.tip = pose
        if self.sink.due("tip"):
            self.enqueue(message, self.scene.extend_trail("tip_path", pose[:2]))

    def on_target(self, message: PoseStamped) -> None:
        """Draw the target, and the circle to keep out of."""
        if not (pose := seen_pose(message)):
            return
        self.scene.target = pose
        if self.sink.due("target"):
            self.add_to_legend("target", scene.TARGET_COLOR)
            self.enqueue(message, self.scene.draw_target(self.t, pose))

    def on_mission(self, message: MissionState) -> None:
        """Store the mission's phase, path and keep-out radius."""
        path = zip(message.path[::3], message.path[1::3], strict=False)
        if self.scene.mission.receive(self.t, message.keep_out, path):
            self.add_to_legend("path planned", scene.PREDICTED_COLOR)
        text = f"{message.mission}: {message.phase}" if message.mission else ""
        text += f", {message.reason}" if message.reason else ""
        self.set_mission_text(text, "WARN" if message.reason else "INFO")

    def on_trajectory(self, message: MultiDOFJointTrajectory) -> None:
        """Store the base's planned path, unless a mission has published its own path."""
        poses = [point.transforms[0].translation for point in message.points if point.transforms]
        if self.scene.mission.receive_base_path(self.t, [(pose.x, pose.y) for pose in poses]):
            self.add_to_legend("path planned", scene.PREDICTED_COLOR)

    def set_mission_text(self, text: str, level: str = "INFO") -> None:
        """Draw and log the mission's state, if it has changed."""
        if text != self.scene.mission.text:
            self.scene.mission.text = text
            self.sink.enqueue(self.t, [scene.phase_label(text)])
            self.log_event(text or "no mission", level)

    def on_thrust(self, message: ThrusterCommand) -> None:
        """Draw plumes while thrusters fire."""
        self.add_to_legend("thrusters", scene.THRUST_COLOR)
        self.scene.fire(self.t, message.on_time)

    def store(self, item: str, value: Any) -> None:
        """Store the value of an item of the strip."""
        self.strip.values[item] = value, time.monotonic()

    def on_propellant(self, message: Float64) -> None:
        """Store the mass of the remaining gas [kg]."""
        self.store(PROPELLANT, message.data)

    def on_reaction(self, message: BaseReaction) -> None:
        """Plot prediction and measurement of the base's motion."""
        sigma = float(message.predicted_deviation[2])
        total = hypot(sigma, message.measured_deviation[2])
        self.store(HEADING, (float(message.difference[2]), total))
        self.scene.store_prediction_error(stamp_ns(message.header.stamp), message.difference, sigma)
        if self.sink.due("reaction"):
            self.enqueue(message, scene.reaction_drawings(message))
            self.enqueue(message, self.scene.extend_trail("com_path", tuple(message.com)))

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """Plot one link's current, and the share of its frames that were lost."""
        i = message.link
        self.strip.links[i] = message, time.monotonic()
        lost = self.losses[i].add(message.sequence)
        if self.sink.due(f"current {i}"):
            current = scene.link_value("current", i, 0.01 * message.current)
            self.enqueue(message, [current, scene.link_value("loss", i, 100.0 * lost)])

    def on_stop(self, _: Empty) -> None:
        """Log that arm/stop was received."""
        self.log_event("arm/stop", "ERROR")

    def on_calibration(self, topic: str, message: Any) -> None:
        """Log a calibration's verdict; if it passed, draw the arm with it."""
        with suppress(ValueError):  # base_reaction reports the error
            self.calibrated = self.calibrated.of_same_links(topic, message)
            self.scene.arm = self.calibrated.arm
        calibration, kind = message.calibration, topic.rpartition("/")[2]
        self.strip.verdicts[kind] = calibration.verdict
        level = "INFO" if calibration.verdict == calibration.PASS else "WARN"
        self.log_event(f"{kind}: {calibration.verdict}: {calibration.reason}", level)

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

    def enqueue(self, message: Any, drawings: list[scene.Drawing]) -> None:
        """Queue drawings, if there are any, at the stamp of a message."""
        if drawings:
            self.sink.enqueue(stamp_ns(message.header.stamp), drawings)

    def add_to_legend(self, name: str, color: scene.Color) -> None:
        """Add a new name to the legend."""
        if entry := self.legend.add(name, color):
            self.sink.enqueue(None, [entry])

    def log_event(self, text: str, level: str) -> None:
        """Add a line to the view's log."""
        text = f"{self.name}: {text}" if self.name else text
        self.sink.enqueue(self.t, [scene.log_line(text, level)])
