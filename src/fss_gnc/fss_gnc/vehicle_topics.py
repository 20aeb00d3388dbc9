"""Topics by which the guidance of several vehicles on one table avoid each other.

Each vehicle publishes `base/plan`, the poses of its base with their times, and `base/footprint`,
its outline. Without poses it drifts; at the last pose it stays.
"""

from collections.abc import Callable
from functools import partial
from math import cos, sin
from typing import Any

import numpy as np
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node

from fss_arm_model.arrays import Complexes
from fss_arm_model.settings import SettingError, default_in
from fss_arm_model.units import SECOND
from fss_arm_model.vehicle import Vehicle
from fss_arm_ros.convert import planar_pose, stamp_ns, to_time
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.subscriptions import PolledSubscription
from fss_gnc import messages
from fss_gnc.guidance.activity import ActivityError, Commands, Craft, Observation
from fss_gnc.guidance.free_space import FreeSpace
from fss_gnc.guidance.other_vehicles import OtherVehicle, VehicleTrack, announced
from fss_gnc.reference import Path

PERIOD = 0.2  # of the announcements [s]
MAX_POINTS = 1000  # of a plan or an outline
MAX_RADIUS = 10.0  # of an outline about the base's origin [m]
MAX_LEAD = 1.0  # of a stamp before this computer's time [s]
KINDS = {"base/state": Odometry, "base/plan": PathMessage, "base/footprint": PolygonStamped}


class VehicleTopics:
    """Announcements of the vehicles in the parameter `vehicles` to each other.

    Args:
        node: the guidance of one of them.
        craft: its base and arm.

    Raises:
        SettingError: the node's namespace is not one of the vehicles, or one is listed twice.
    """

    def __init__(self, node: Node, craft: Craft) -> None:
        self._node, self._free_space = node, FreeSpace(craft)
        self._announced = 0  # time of the last announcement [ns]
        self._plan: Path | None = None  # last announced
        space, _, own = node.get_namespace().rpartition("/")
        names = craft.settings.vehicles
        if names and (own not in names or len(set(names)) < len(names)):
            raise SettingError(
                f"vehicles is {list(names)}, expected each vehicle once, with this one, {own!r}"
            )
        self.tracks = [
            VehicleTrack(name, names.index(name) < names.index(own))
            for name in names
            if name != own
        ]
        self._frame = default_in(Vehicle.__dataclass_fields__["base_frame"], node.get_namespace())
        self._subscriptions = [
            PolledSubscription(node, kind, name, partial(self._store, name, store, track))
            for track in self.tracks
            for (topic, kind), store in zip(
                KINDS.items(), (store_state, store_plan, store_footprint), strict=True
            )
            for name in [f"{space}/{track.name}/{topic}"]
        ]
        topics = list(KINDS)[1:] if self.tracks else []
        self._outputs = [node.create_publisher(KINDS[name], name, SENSOR) for name in topics]

    def observe(self, now: int) -> tuple[OtherVehicle, ...]:
        """Return the other vehicles whose state and outline were received, at `now` [ns]."""
        for subscription in self._subscriptions:
            subscription.poll()
        found = (track.predicted(now) for track in self.tracks)
        return tuple(other for other in found if other)

    def problem(self) -> str:
        """Return which vehicles were never received, or are silent; empty: none."""
        now = self._node.get_clock().now().nanoseconds
        known = {other.name: other for other in self.observe(now)}
        missing = [track.name for track in self.tracks if track.name not in known]
        silent = [f"{name} is silent" for name, other in known.items() if other.is_silent]
        return "; ".join([f"waiting for {name}/base/footprint" for name in missing] + silent)

    def announce(self, commands: Commands | None, obs: Observation, now: int) -> None:
        """Publish plan and outline at `now` [ns], in their period or when the plan has changed.

        Args:
            commands: newest commands of the running activity; None: the base drifts.
            obs: known state, by the activity's time.
            now: present time [ns].
        """
        plan = commands.plan if commands else None
        is_recent = 0 <= now - self._announced < PERIOD * SECOND  # not if the clock was set back
        if not self._outputs or (is_recent and plan is self._plan):
            return
        try:
            polygon = footprint(self._free_space.outline(obs.with_joints_at_rest()))
        except ActivityError:
            return  # base or joints are not known
        self._announced, self._plan = now, plan
        polygon.header.stamp, polygon.header.frame_id = to_time(now), self._frame
        for publisher, message in zip(
            self._outputs, (plan_message(plan, obs.t, now), polygon), strict=True
        ):
            publisher.publish(message)

    def _store(
        self,
        topic: str,
        store: Callable[[VehicleTrack, Any], None],
        track: VehicleTrack,
        message: Any,
    ) -> None:
        """Store a message of another vehicle; reject it if it is invalid."""
        try:
            now = self._node.get_clock().now().nanoseconds
            lead = (stamp_ns(message.header.stamp) - now) / SECOND
            if lead > MAX_LEAD:
                raise ValueError(f"header.stamp is {lead:.1f} s in the future")
            store(track, message)
        except ValueError as error:
            line = f"{topic} rejected: {error}"
            self._node.get_logger().warning(line, throttle_duration_sec=1.0)


def store_state(track: VehicleTrack, message: Odometry) -> None:
    """Store a state with the largest standard deviations of position and speed.

    Raises:
        ValueError: the pose or the twist is invalid.
    """
    variances = (max(c[0], c[7], 0.0) for c in (message.pose.covariance, message.twist.covariance))
    deviations = (float(np.sqrt(variance)) for variance in variances)
    track.store_state(stamp_ns(message.header.stamp), messages.body(message), *deviations)


def store_plan(track: VehicleTrack, message: PathMessage) -> None:
    """Store a plan.

    Raises:
        ValueError: it is not a planar path in the world, or too long.
    """
    if (count := len(message.poses)) > MAX_POINTS:
        raise ValueError(f"{count} poses, expected at most {MAX_POINTS}")
    if (frame := message.header.frame_id) != messages.WORLD:
        raise ValueError(f"frame_id is {frame[:40]!r}, expected {messages.WORLD!r}")
    stamp, path = stamp_ns(message.header.stamp), None
    if message.poses:
        times = [(stamp_ns(pose.header.stamp) - stamp) / SECOND for pose in message.poses]
        poses = np.array([planar_pose(pose.pose) for pose in message.poses])
        poses[:, 2] = np.unwrap(poses[:, 2])
        path = Path(np.array(times), poses[:, None])
    track.store_plan(stamp, path)


def store_footprint(track: VehicleTrack, message: PolygonStamped) -> None:
    """Store an outline.

    Raises:
        ValueError: it has too few or too many vertices, no area, or is too large.
    """
    if not 3 <= (count := len(message.polygon.points)) <= MAX_POINTS:
        raise ValueError(f"{count} vertices, expected 3 to {MAX_POINTS}")
    outline = np.array([complex(point.x, point.y) for point in message.polygon.points])
    if not (radius := float(np.abs(outline).max())) <= MAX_RADIUS:
        raise ValueError(f"a vertex is {radius:g} m from the base, expected at most {MAX_RADIUS:g}")
    area = float(np.imag(np.conj(outline) * np.roll(outline, -1)).sum())
    if not area:
        raise ValueError("the outline has no area")
    track.outline = outline if area > 0.0 else outline[::-1]


def plan_message(path: Path | None, t: float, stamp: int) -> PathMessage:
    """Return the poses of a path from its time t on; none if there is no path.

    Args:
        path: of the base; None: it drifts.
        t: present time on the path [s].
        stamp: present time [ns].
    """
    message = PathMessage()
    message.header.stamp, message.header.frame_id = to_time(stamp), messages.WORLD
    if path is None:
        return message
    plan = announced(path, t)
    for time, (x, y, heading) in zip(plan.times.tolist(), plan.knots[:, 0].tolist(), strict=True):
        pose = PoseStamped()
        pose.header.stamp = to_time(stamp + round(time * SECOND))
        pose.header.frame_id = messages.WORLD
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z, pose.pose.orientation.w = sin(0.5 * heading), cos(0.5 * heading)
        message.poses.append(pose)
    return message


def footprint(outline: Complexes) -> PolygonStamped:
    """Return an outline as a polygon."""
    message = PolygonStamped()
    message.polygon.points = [Point32(x=float(v.real), y=float(v.imag)) for v in outline]
    return message
