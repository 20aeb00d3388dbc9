"""Processor share of `control` at 100 Hz, compared with a bare node that has the same topics.

Base states are published at 100 Hz, joints and their plan at 20 Hz, the trajectory at 10 Hz. The
bare node stores the last message of each topic and publishes a wrench at the same rate. Limit: a
tenth of a core.

    . scripts/env.sh; python bench/bench_control.py
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint, MultiDOFJointTrajectory

from fss_arm_ros.convert import to_time
from fss_arm_ros.qos import SENSOR, subscribe_sensor
from fss_arm_ros.run import run
from fss_gnc import messages
from fss_gnc.reference import Path as BasePath

RATE = 100.0  # of base states and wrenches [1/s]
TOPICS = {
    "base/state": (Odometry, 1),
    "arm/joint_states": (JointState, 5),
    "arm/planned": (JointTrajectory, 5),
    "base/trajectory": (MultiDOFJointTrajectory, 10),
}
NAMES = [f"joint_{i}" for i in range(1, 5)]


class BareNode(Node):
    """Stores the received messages and publishes a wrench at the same rate."""

    def __init__(self) -> None:
        super().__init__("bare")
        self.last: dict[str, object] = {}
        for name, (kind, _) in TOPICS.items():
            subscribe_sensor(self, kind, name, lambda m, name=name: self.last.update({name: m}))
        self.wrench = self.create_publisher(WrenchStamped, "bare/wrench", 1)
        self.create_timer(1.0 / RATE, self.tick)

    def tick(self) -> None:
        """Publish a zero wrench."""
        message = WrenchStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        self.wrench.publish(message)


class World(Node):
    """Publishes the inputs of control; the joints oscillate."""

    def __init__(self) -> None:
        super().__init__("world")
        self.publishers_to = {
            name: self.create_publisher(kind, name, SENSOR) for name, (kind, _) in TOPICS.items()
        }
        self.count, self.received = 0, {"base/wrench": 0, "bare/wrench": 0}
        for name in self.received:
            self.create_subscription(WrenchStamped, name, lambda _, n=name: self.on_wrench(n), 100)
        self.create_timer(1.0 / RATE, self.tick)

    def on_wrench(self, name: str) -> None:
        """Count a wrench."""
        self.received[name] += 1

    def tick(self) -> None:
        """Publish the messages that are due."""
        now = int(self.get_clock().now().nanoseconds)
        t = self.count / RATE
        for name, (_, every) in TOPICS.items():
            if self.count % every == 0:
                self.publishers_to[name].publish(self.message(name, now, t))
        self.count += 1

    def message(self, name: str, now: int, t: float) -> object:
        """Return the message of a topic at a time."""
        if name == "base/trajectory":
            path = BasePath(np.array([0.0, 2.0]), np.zeros((2, 3, 3)))
            return messages.trajectory(path, 0.0, now, 2.0, 0.25)
        if name == "base/state":
            message = Odometry()
            message.pose.pose.orientation.w = 1.0
            message.pose.pose.position.x = 0.01
        elif name == "arm/joint_states":
            q, qd = [float(np.sin(t))] * 4, [float(np.cos(t))] * 4
            message = JointState(name=NAMES, position=q, velocity=qd, effort=[0.0] * 4)
        else:
            message = JointTrajectory(joint_names=NAMES)
            for k in range(6):
                q, qd = [float(np.sin(t + 0.1 * k))] * 4, [float(np.cos(t + 0.1 * k))] * 4
                since = Duration(seconds=0.1 * k).to_msg()
                point = JointTrajectoryPoint(positions=q, velocities=qd, time_from_start=since)
                message.points.append(point)
        message.header.stamp = to_time(now)
        return message


def cpu(pid: int) -> float:
    """Return the processor time of a process [s]."""
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def compare(seconds: float) -> int:
    """Print both shares; return 1 if that of control exceeds the limit."""
    options = ["--ros-args", "-p", f"rate:={RATE}"]
    programs = {
        "base/wrench": subprocess.Popen([sys.executable, "-m", "fss_gnc.control_node", *options]),
        "bare/wrench": subprocess.Popen([sys.executable, __file__, "--bare"]),
    }
    rclpy.init()
    world = World()
    try:
        while min(world.received.values()) < RATE:  # both are running and warmed up
            rclpy.spin_once(world)
        before = {name: cpu(program.pid) for name, program in programs.items()}
        received, start = dict(world.received), time.monotonic()
        while (elapsed := time.monotonic() - start) < seconds:
            rclpy.spin_once(world)
        share = {n: (cpu(program.pid) - before[n]) / elapsed for n, program in programs.items()}
    finally:
        for program in programs.values():
            program.terminate()
            program.wait()
    for name, value in share.items():
        rate = (world.received[name] - received[name]) / elapsed
        print(f"{name}: {rate:.1f} Hz, {100 * value:.1f} % of a core")
    print(f"control / bare: {share['base/wrench'] / share['bare/wrench']:.2f}")
    return int(share["base/wrench"] >= 0.1)


def main() -> int:
    """Compare the nodes, or run the bare node."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    return run(BareNode, sys.argv[:1]) if options.bare else compare(options.seconds)


if __name__ == "__main__":
    sys.exit(main())
