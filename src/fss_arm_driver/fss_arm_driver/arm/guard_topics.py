"""Collision guard of the arm's node, for new motions and for the current one.

Without the base's pose the arm is only guarded against itself and its base, and without the
target's pose not against the target; diagnostics report the present case. The current motion is
checked again at each tick, from the present state of arm and base. It ends if less than half of
the margins would remain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from fss_arm_driver.arm.move import Profile
from fss_arm_driver.arm.state import LinkState
from fss_arm_driver.arm.stream import SetPoint
from fss_arm_driver.arm.trajectory import Trajectory
from fss_arm_driver.protocol import Mode
from fss_arm_driver.settings import ArmSettings
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.guard.guard import Guard
from fss_arm_ros.convert import SECOND, planar_pose, seen_pose, stamp_ns
from fss_arm_ros.subscriptions import PolledSubscription


class GuardTopics:
    """Guard that rejects motions which bring bodies too close, from the poses of base and target.

    Its checks raise GuardError.
    """

    def __init__(self, node: Node, arm: Arm, settings: ArmSettings) -> None:
        self.node, self.arm, self.settings = node, arm, settings
        self.guard = self.running_guard = None
        if settings.guard:
            half = replace(
                settings, margin=0.5 * settings.margin, edge_margin=0.5 * settings.edge_margin
            )
            self.guard, self.running_guard = Guard(arm, settings), Guard(arm, half)
        self.base: tuple[int, Floats, Floats] = 0, np.zeros(3), np.zeros(3)  # stamp, pose, twist
        self.target: tuple[int, Floats] = 0, np.zeros(3)  # time of reception, pose
        self.subscriptions = (
            PolledSubscription(node, Odometry, "base/state", self.on_base),
            PolledSubscription(node, PoseStamped, settings.target_topic, self.on_target),
        )

    def now(self) -> int:
        """Return the time of the node's clock [ns]."""
        return int(self.node.get_clock().now().nanoseconds)

    def poll(self) -> None:
        """Receive the poses of base and target; call it often, because their age matters."""
        for subscription in self.subscriptions:
            subscription.poll()

    def on_base(self, message: Odometry) -> None:
        """Store the pose of the base, and its twist, converted from base to world axes."""
        pose = np.array(planar_pose(message.pose.pose))
        v, c, s = message.twist.twist, np.cos(pose[2]), np.sin(pose[2])
        x, y = v.linear.x, v.linear.y
        twist = np.array([c * x - s * y, s * x + c * y, v.angular.z])
        self.base = stamp_ns(message.header.stamp), pose, twist

    def on_target(self, message: PoseStamped) -> None:
        """Store the pose of the target, unless it is occluded."""
        if pose := seen_pose(message):
            self.target = self.now(), np.array(pose)

    def known_bodies(self, at: int = 0) -> dict[str, Any]:
        """Return the arguments of the guard for base and target, if known and recent.

        Args:
            at: time to which the base's pose is extrapolated [ns]; now by default.
        """
        now, age = self.now(), self.settings.base_age * SECOND
        stamp, pose, twist = self.base
        if abs(now - stamp) >= age:
            return {}
        found = {"base": pose + twist * (((at or now) - stamp) / SECOND), "twist": twist}
        return found | ({"target": self.target[1]} if self.target[0] > now - age else {})

    def describe_protection(self) -> str:
        """Return the names of the bodies that the arm is guarded against now."""
        if self.guard is None:
            return "off"
        known = self.known_bodies()
        return ", ".join(self.guard.guards(known.get("base"), known.get("target")))

    def check_trajectory(self, trajectory: Trajectory, now: int = 0) -> None:
        """Check a new trajectory; given the time `now` [ns], check the rest of the current one."""
        guard = self.running_guard if now else self.guard
        if guard is None or now >= trajectory.end:
            return
        self.poll()
        times, q, qd, since = trajectory.times, trajectory.q, trajectory.qd, now
        if now > trajectory.begin:
            # From the time of the base's pose: its twist matches the joints' state only then.
            oldest = now - round(self.settings.base_age * SECOND)
            since = max(trajectory.begin, oldest, min(now, self.base[0]))
            state, times = trajectory.at(since), times - (since - trajectory.begin) / SECOND
            remaining = times > 0.0
            times = np.concatenate([[0.0], times[remaining]])
            q, qd = np.vstack([state[0], q[remaining]]), np.vstack([state[1], qd[remaining]])
        guard.check_path(times, q, qd, **self.known_bodies(since))

    def check_move(
        self, links: Mapping[int, LinkState], profiles: Sequence[Profile], until: float = inf
    ) -> None:
        """Check a new move, or the current one with its remaining time `until` the timeout [s].

        A joint that turns little is commanded to turn slowly, so its arrival is not awaited.
        """
        guard = self.guard if until == inf else self.running_guard
        if guard is None:
            return
        self.poll()
        limits = [link.drive for link in self.arm.links]
        guard.check_command(
            *joint_states(links),
            position=[p.target for p in profiles],
            max_velocity=[
                p.velocity or k.max_velocity for p, k in zip(profiles, limits, strict=True)
            ],
            max_acceleration=[
                p.acceleration or k.max_acceleration for p, k in zip(profiles, limits, strict=True)
            ],
            until=until,
            **self.known_bodies(),
        )

    def check_stream(self, links: Mapping[int, LinkState], points: Sequence[SetPoint]) -> None:
        """Check a message of a stream, as if it were the last; joints not named rest."""
        if self.guard is None or len(links) < self.arm.n:
            return
        self.poll()
        q, qd = joint_states(links)
        velocity, position = np.zeros(self.arm.n), np.full(self.arm.n, np.nan)
        for i, mode, value in points:
            limit = self.arm.links[i - 1].drive.max_velocity
            if mode == Mode.POSITION:
                position[i - 1] = value
            elif mode == Mode.VELOCITY:
                velocity[i - 1] = np.clip(value, -limit, limit)
            else:
                velocity[i - 1] = np.sign(value) * limit
        self.guard.check_command(
            q,
            qd,
            self.settings.stream_time_to_live,
            velocity=velocity,
            position=position,
            **self.known_bodies(),
        )


def joint_states(links: Mapping[int, LinkState]) -> tuple[Floats, Floats]:
    """Return the readings [rad] and rates [rad/s] of all joints, (n) each."""
    states = [links[i] for i in sorted(links)]
    return np.array([s.q for s in states]), np.array([s.qd for s in states])
