"""The guard of the arm's node: what is to begin, and what is under way, keeps bodies apart.

Without the base's pose the arm is guarded against itself and its base, without the target's not
against that; how it is now, diagnostics say. What is under way is judged again at each tick, from
where arm and base are by then, and ends if less than half of the margins would remain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from fss_arm_driver.arm.request import Floats
from fss_arm_driver.arm.state import LinkState
from fss_arm_driver.arm.stream import SetPoint
from fss_arm_driver.arm.trajectory import Trajectory
from fss_arm_driver.move import Profile
from fss_arm_driver.protocol import Mode
from fss_arm_driver.settings import ArmSettings
from fss_arm_model.description import Arm
from fss_arm_model.guard.guard import Guard
from fss_arm_ros.convert import SECOND, planar_pose, seen_pose, stamp_ns
from fss_arm_ros.subscriptions import PolledSubscription


class GuardTopics:
    """Refuses what would bring bodies too near, by what is known of base and target.

    Its checks raise GuardError.
    """

    def __init__(self, node: Node, arm: Arm, settings: ArmSettings) -> None:
        self.node, self.arm, self.settings = node, arm, settings
        self.guard = self.under_way = None
        if settings.guard:
            half = replace(
                settings, margin=0.5 * settings.margin, edge_margin=0.5 * settings.edge_margin
            )
            self.guard, self.under_way = Guard(arm, settings), Guard(arm, half)
        self.base: tuple[int, Floats, Floats] = 0, np.zeros(3), np.zeros(3)  # stamp, pose, twist
        self.target: tuple[int, Floats] = 0, np.zeros(3)  # heard, pose
        self.polled = (
            PolledSubscription(node, Odometry, "base/state", self.on_base),
            PolledSubscription(node, PoseStamped, settings.target_topic, self.on_target),
        )

    def now(self) -> int:
        """The node's clock [ns]."""
        return int(self.node.get_clock().now().nanoseconds)

    def look(self) -> None:
        """See where base and target are, often enough to know how old that is."""
        for subscription in self.polled:
            subscription.poll()

    def on_base(self, message: Odometry) -> None:
        """Learn where the base is, and how it moves: its twist is along its own axes."""
        pose = np.array(planar_pose(message.pose.pose))
        v, c, s = message.twist.twist, np.cos(pose[2]), np.sin(pose[2])
        x, y = v.linear.x, v.linear.y
        twist = np.array([c * x - s * y, s * x + c * y, v.angular.z])
        self.base = stamp_ns(message.header.stamp), pose, twist

    def on_target(self, message: PoseStamped) -> None:
        """Learn where the target is; nothing while it is hidden."""
        if pose := seen_pose(message):
            self.target = self.now(), np.array(pose)

    def known(self, at: int = 0) -> dict[str, Any]:
        """Base and target as the guard takes them, as far as they are known and not old.

        Args:
            at: for when the base is told [ns]; now by default.
        """
        now, age = self.now(), self.settings.base_age * SECOND
        stamp, pose, twist = self.base
        if abs(now - stamp) >= age:
            return {}
        found = {"base": pose + twist * (((at or now) - stamp) / SECOND), "twist": twist}
        return found | ({"target": self.target[1]} if self.target[0] > now - age else {})

    def words(self) -> str:
        """Against what the arm is guarded now."""
        if self.guard is None:
            return "off"
        known = self.known()
        return ", ".join(self.guard.guards(known.get("base"), known.get("target")))

    def check_trajectory(self, trajectory: Trajectory, now: int = 0) -> None:
        """Check a trajectory that is to begin; with a time [ns], what of one is still to come."""
        guard = self.under_way if now else self.guard
        if guard is None or now >= trajectory.end:
            return
        self.look()
        times, q, qd, since = trajectory.times, trajectory.q, trajectory.qd, now
        if now > trajectory.begin:
            # When the base was seen: with joints as they are by now, its twist is no momentum.
            oldest = now - round(self.settings.base_age * SECOND)
            since = max(trajectory.begin, oldest, min(now, self.base[0]))
            here, times = trajectory.at(since), times - (since - trajectory.begin) / SECOND
            rest = times > 0.0
            times = np.concatenate([[0.0], times[rest]])
            q, qd = np.vstack([here[0], q[rest]]), np.vstack([here[1], qd[rest]])
        guard.check_path(times, q, qd, **self.known(since))

    def check_move(
        self, links: Mapping[int, LinkState], profiles: Sequence[Profile], until: float = inf
    ) -> None:
        """Check a move that is to begin, or one that is under way `until` it is given up [s].

        A joint that hardly turns is told to do so slowly, and need not be waited for.
        """
        guard = self.guard if until == inf else self.under_way
        if guard is None:
            return
        self.look()
        limits = [link.drive for link in self.arm.links]
        guard.check_command(
            *present(links),
            position=[p.target for p in profiles],
            max_velocity=[
                p.velocity or k.max_velocity for p, k in zip(profiles, limits, strict=True)
            ],
            max_acceleration=[
                p.acceleration or k.max_acceleration for p, k in zip(profiles, limits, strict=True)
            ],
            until=until,
            **self.known(),
        )

    def check_stream(self, links: Mapping[int, LinkState], points: Sequence[SetPoint]) -> None:
        """Check a message of a stream, as if none followed; joints that it does not name rest."""
        if self.guard is None or len(links) < self.arm.n:
            return
        self.look()
        q, qd = present(links)
        velocity, position = np.zeros(self.arm.n), np.full(self.arm.n, np.nan)
        for i, mode, value in points:
            most = self.arm.links[i - 1].drive.max_velocity
            if mode == Mode.POSITION:
                position[i - 1] = value
            elif mode == Mode.VELOCITY:
                velocity[i - 1] = np.clip(value, -most, most)
            else:
                velocity[i - 1] = np.sign(value) * most
        self.guard.check_command(
            q, qd, self.settings.stream_time_to_live, velocity=velocity, position=position,
            **self.known(),
        )  # fmt: skip


def present(links: Mapping[int, LinkState]) -> tuple[Floats, Floats]:
    """Readings [rad] and rates [rad/s] of all joints, (n) each."""
    states = [links[i] for i in sorted(links)]
    return np.array([s.q for s in states]), np.array([s.qd for s in states])
