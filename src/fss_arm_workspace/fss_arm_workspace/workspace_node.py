"""Node `workspace`: workspace and manipulability of the calibrated arm in its present posture."""

import sys
from collections import deque
from math import isfinite
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from fss_arm_ros.calibrated import Calibrated
from fss_arm_ros.calibrations import subscribe_calibrations
from fss_arm_ros.convert import joint_readings, seen_pose
from fss_arm_ros.described_arm import load_described_arm
from fss_arm_ros.diagnostics import ERROR, OK, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.timers import timer_clock
from fss_arm_workspace import messages
from fss_arm_workspace.analysis import analyze, load_kernels, straight_workspaces
from fss_arm_workspace.calibrations import Calibrations
from fss_arm_workspace.programs import workspace as main
from fss_arm_workspace.regions.fixed import joint_limits
from fss_arm_workspace.settings import WorkspaceSettings
from fss_arm_workspace.start_state import PathStart, posture
from fss_arm_workspace.worker import Progress, Worker

#: Change of a joint or of the base's pose after which straight paths are recomputed [m or rad].
MIN_CHANGE = 0.02


class WorkspaceNode(Node):
    """Node that publishes the arm's workspace, and recomputes it when arm or state change."""

    def __init__(self, **options: Any) -> None:
        super().__init__("workspace", **options)
        s = self.settings = declare(self, WorkspaceSettings)
        self.calibrations = Calibrations(Calibrated(load_described_arm(self, s.arm)))
        self.received: deque[tuple[str, Any]] = deque()  # calibrations that passed, by topic
        load_kernels(self.calibrations.calibrated.arm)
        self.readings: dict[int, float] = {}  # joint readings, by joint number
        self.pose: tuple[float, float, float] | None = None
        self.path_start: PathStart | None = None  # of the last straight paths
        self.workspace_publishers = {
            name: self.create_publisher(kind, f"workspace/{name}", LATCHED)
            for name, kind in messages.topics().items()
        }
        self.maps = Worker(self.compute_maps)
        self.paths = Worker(self.compute_paths)
        self.maps.submit("description")
        subscribe_calibrations(self, self.on_calibration)
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)
        self.base = PolledSubscription(self, PoseStamped, s.base_topic, self.on_pose)
        self.create_timer(1.0 / s.rate, self.on_timer, clock=timer_clock(self))
        self.diagnostics = Diagnostics(self, self.health)
        n = self.calibrations.calibrated.arm.n
        self.get_logger().info(f"subscribed to joint_states and {s.base_topic} (joints: {n})")

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
        calibrated = self.calibrations.calibrated
        if (q := posture(self.readings, calibrated.arm.n)) is None:
            return
        self.base.poll()
        s, header = self.settings, self.header(self.settings.base_frame)
        ellipsoids = messages.ellipsoid_markers(calibrated.arm, q, s.scale, header)
        self.publish("ellipsoids", ellipsoids)
        state = np.concatenate([self.pose or np.zeros(3), q])
        start = PathStart(calibrated, state, self.pose is not None)
        if not self.paths.busy and not start.is_near(self.path_start, MIN_CHANGE):
            self.path_start = start
            self.paths.submit(start)

    def compute_maps(self, _: str, progress: Progress) -> None:
        """Compute and publish the results that depend on the arm alone (worker's thread)."""
        while self.received:
            topic, message = self.received.popleft()
            try:
                self.calibrations.add(topic, message)
            except ValueError as error:
                self.get_logger().warning(f"{topic} rejected: {error}")
        found = analyze(self.calibrations.calibrated, self.settings, progress)
        header = self.header(self.settings.base_frame)
        for name, message in messages.map_messages(found, self.settings, header):
            self.publish(name, message)

    def compute_paths(self, start: PathStart, progress: Progress) -> None:
        """Compute and publish the straight paths from a state (worker's thread)."""
        arm, q, s = start.calibrated.arm, start.state, self.settings
        limits = joint_limits(arm, of_true_angle=s.of_true_angle)
        within = np.append(q[:3], q[3:].clip(*limits.T))  # readings may exceed a limit
        found = straight_workspaces(arm, within, s, progress)
        header = self.header(s.world_frame if start.in_world else s.base_frame)
        for name, message in messages.path_messages(arm, found, header):
            self.publish(name, message)

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
        values = {"arm": self.calibrations.calibrated.arm.name, "maps": self.maps.status}
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


def make_node() -> WorkspaceNode:
    """Publish workspace and maps, and straight paths and ellipsoids of the present posture.

    All are recomputed after a calibration that passed; straight paths also after arm or base moved.
    """
    return WorkspaceNode()


if __name__ == "__main__":
    sys.exit(main())
