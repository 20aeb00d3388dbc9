"""Node `workspace`: workspace and manipulability of the calibrated arm in its present posture."""

import sys
from collections import deque
from functools import partial
from math import isfinite, pi, remainder
from typing import Any

import numpy as np
from geometry_msgs.msg import PolygonStamped, PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from fss_arm_model.description_file import described
from fss_arm_msgs.msg import (
    DynamicCalibration,
    KinematicCalibration,
    ManipulabilityMap,
    StraightPaths,
    Workspace,
)
from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.convert import joint_readings, seen_pose
from fss_arm_ros.diagnostics import ERROR, OK, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe
from fss_arm_workspace import messages
from fss_arm_workspace.analysis import analyze, load_kernels, straight_workspaces
from fss_arm_workspace.programs import workspace as main
from fss_arm_workspace.regions.arcs import Floats
from fss_arm_workspace.regions.fixed import joint_limits
from fss_arm_workspace.regions.virtual import VirtualManipulator
from fss_arm_workspace.settings import WorkspaceSettings
from fss_arm_workspace.straight_path.redundancy import BASES
from fss_arm_workspace.worker import Progress, Worker


class WorkspaceNode(Node):
    """Node that publishes the arm's workspace, and recomputes it when arm or state change."""

    def __init__(self, **options: Any) -> None:
        super().__init__("workspace", **options)
        s = self.settings = declare(self, WorkspaceSettings)
        self.described = self.calibrated = Calibrated(described(s.arm))
        self.received: deque[tuple[str, Any]] = deque()  # calibrations that passed, by topic
        self.calibrations: dict[str, Any] = {}  # last accepted of each kind, the newest last
        load_kernels(self.calibrated.arm)
        self.readings: dict[int, float] = {}  # joint readings, by joint number
        self.pose: tuple[float, float, float] | None = None
        self.path_start: tuple[Calibrated, Floats] | None = None  # start of the last straight paths
        kinds: dict[str, type] = {"result": Workspace, "boundary": PolygonStamped}
        kinds |= {"markers": MarkerArray, "straight_markers": MarkerArray}
        for base in ("fixed", "floating"):
            kinds |= {f"map/{base}": OccupancyGrid, f"manipulability/{base}": ManipulabilityMap}
        for base in map(_topic_name, BASES):
            kinds |= {f"straight/{base}": PolygonStamped, f"straight_paths/{base}": StraightPaths}
        kinds["ellipsoids"] = MarkerArray
        self.workspace_publishers = {
            name: self.create_publisher(kind, f"workspace/{name}", LATCHED)
            for name, kind in kinds.items()
        }
        self.maps = Worker(self.compute_maps)
        self.paths = Worker(self.compute_paths)
        self.maps.submit("description")
        for topic, kind in (
            ("calibration/kinematic", KinematicCalibration),
            ("calibration/dynamic", DynamicCalibration),
        ):
            subscribe(self, kind, topic, partial(self.on_calibration, topic), LATCHED)
        subscribe_sensor(self, JointState, s.joints_topic, self.on_joints)
        self.base = PolledSubscription(self, PoseStamped, s.base_topic, self.on_pose)
        self.create_timer(1.0 / s.rate, self.on_timer, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health)

    def on_calibration(self, topic: str, message: Any) -> None:
        """Recompute the maps with a calibration, if it passed."""
        if message.calibration.verdict == message.calibration.PASS:
            self.received.append((topic, message))
            self.maps.submit(topic)

    def on_joints(self, message: JointState) -> None:
        """Store the readings of one or more links."""
        self.readings |= {i: q for i, q, *_ in joint_readings(message) if isfinite(q)}

    def on_pose(self, message: PoseStamped) -> None:
        """Store the pose of the base."""
        if pose := seen_pose(message):
            self.pose = pose
        else:
            self.get_logger().debug("the base is occluded")

    def on_timer(self) -> None:
        """Publish the ellipsoids; recompute the straight paths when arm or base have moved."""
        calibrated, q = self.calibrated, self.posture()
        if q is None:
            return
        self.base.poll()
        header = self.header(self.settings.base_frame)
        self.publish(
            "ellipsoids", messages.ellipsoid_markers(calibrated.arm, q, self.settings.scale, header)
        )
        state = np.concatenate([self.pose or np.zeros(3), q])
        if not self.paths.busy and not self.is_current(calibrated, state):
            self.path_start = calibrated, state
            self.paths.submit((calibrated, state, self.pose is not None))

    def posture(self) -> Floats | None:
        """Return the joint readings (n,) [rad]; None until all have been received."""
        joints = range(1, self.calibrated.arm.n + 1)
        if not all(i in self.readings for i in joints):
            return None
        return np.array([self.readings[i] for i in joints])

    def is_current(self, calibrated: Calibrated, state: Floats) -> bool:
        """Return True if the last straight paths start near the state, with the same arm."""
        if self.path_start is None or self.path_start[0] is not calibrated:
            return False
        change = state - self.path_start[1]
        change[2] = remainder(change[2], 2.0 * pi)
        return bool((np.abs(change) <= self.settings.motion_threshold).all())

    def add_calibration(self, topic: str, message: Any) -> None:
        """Add a calibration to the known arm, unless it is of another arm (worker's thread)."""
        calibrations = {k: v for k, v in self.calibrations.items() if k != topic}
        calibrations[topic] = message
        try:
            self.calibrated = self.with_calibrations(calibrations)
            self.calibrations = calibrations
        except ValueError as error:
            self.get_logger().warning(f"{topic} is left out: {error}")

    def with_calibrations(self, calibrations: dict[str, Any]) -> Calibrated:
        """Return the described arm updated by calibrations.

        Raises:
            ValueError: a calibration is not of this arm.
        """
        calibrated = self.described
        for topic, message in calibrations.items():
            calibrated = calibrated.with_message(topic, message)
        if calibrated.arm.n != self.described.arm.n:
            raise ValueError(f"it is for {calibrated.arm.n} links, expected {self.described.arm.n}")
        return calibrated

    def compute_maps(self, _: str, progress: Progress) -> None:
        """Compute and publish the results that depend on the arm alone (worker's thread)."""
        while self.received:
            self.add_calibration(*self.received.popleft())
        calibrated, settings = self.calibrated, self.settings
        found = analyze(calibrated, settings, progress)
        header = self.header(self.settings.base_frame)
        for base, one in found.maps.items():
            self.publish(f"map/{base}", messages.occupancy_grid(one, header))
            self.publish(f"manipulability/{base}", messages.map_message(one, base, header))
        self.publish("boundary", messages.polygon(found.boundary[0][0], header))
        self.publish("markers", messages.workspace_markers(found, header))
        self.publish("result", messages.workspace_message(found, settings, header))

    def compute_paths(self, request: tuple[Calibrated, Floats, bool], progress: Progress) -> None:
        """Compute and publish the straight paths from a state (worker's thread)."""
        (calibrated, state, in_world), s = request, self.settings
        limits = joint_limits(calibrated.arm, of_true_angle=s.of_true_angle)
        start = np.append(state[:3], state[3:].clip(*limits.T))  # readings may exceed a limit
        found = straight_workspaces(calibrated.arm, start, s, progress)
        header = self.header(s.world_frame if in_world else s.base_frame)
        for base, paths in found.items():
            self.publish(f"straight/{_topic_name(base)}", messages.polygon(paths.ends, header))
            self.publish(
                f"straight_paths/{_topic_name(base)}",
                messages.straight_message(paths, base, header),
            )
        radius = VirtualManipulator(calibrated.arm).radius
        self.publish(
            "straight_markers", messages.straight_markers(calibrated.arm, found, radius, header)
        )

    def publish(self, name: str, message: Any) -> None:
        """Publish from any thread; errors during shutdown are ignored."""
        try:
            self.workspace_publishers[name].publish(message)
        except RCLError:
            if self.context.ok():
                raise

    def header(self, frame_id: str) -> Header:
        """Return a header with the present time and a frame."""
        return Header(stamp=self.get_clock().now().to_msg(), frame_id=frame_id)

    def health(self) -> Health:
        """Return the node's health for diagnostics."""
        values = {"arm": self.calibrated.arm.name, "maps": self.maps.status}
        values["straight paths"] = self.paths.status
        failure = self.maps.failure or self.paths.failure
        if failure:
            return Health(ERROR, failure, values)
        state = "computing" if self.maps.busy or self.paths.busy else "up to date"
        return Health(OK, state, values)

    def close(self) -> None:
        """Stop the workers."""
        self.maps.close()
        self.paths.close()


def _topic_name(base: str) -> str:
    return base.replace(" ", "_")


def make_node() -> WorkspaceNode:
    """Publish workspace and maps, and straight paths and ellipsoids of the present posture.

    All are recomputed after a calibration that passed; straight paths also after arm or base moved.
    """
    return WorkspaceNode()


if __name__ == "__main__":
    sys.exit(main())
