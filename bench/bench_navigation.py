"""Core share of the node `navigation`, compared with a node that only subscribes.

Inputs: poses of base and target and the gyro at 100 Hz, four joints at 5 Hz each, their plan at
20 Hz, pulses of the thrusters at 10 Hz. The peer has the same subscriptions in rclpy's executor and
ignores the messages.
"""

import argparse
import os
import subprocess
import sys
import time
from contextlib import suppress
from math import inf
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fss_arm_msgs.msg import GripperState, ThrusterCommand
from fss_arm_ros.convert import pose_stamped, to_time
from fss_arm_ros.qos import SENSOR, sensor, subscribe_sensor

TOPICS = (
    ("vicon/fss/fss", PoseStamped),
    ("vicon/target/target", PoseStamped),
    ("fog/imu", Imu),
    ("joint_states", JointState),
    ("arm/planned", JointTrajectory),
    ("thrusters/pulses", ThrusterCommand),
    ("gripper/state", GripperState),
)
FRAME = 0.01  # [s]
TICKS = os.sysconf("SC_CLK_TCK")


class Listener(Node):
    """Subscribes to the inputs of navigation."""

    def __init__(self) -> None:
        super().__init__("listener")
        for topic, kind in TOPICS:
            subscribe_sensor(self, kind, topic, lambda message: None)


def listen() -> None:
    """Run the peer until it is terminated."""
    rclpy.init()
    spinner = SingleThreadedExecutor()
    spinner.add_node(Listener())
    with suppress(ExternalShutdownException):
        spinner.spin()


class Source(Node):
    """Publishes the inputs, and measures the latency of the states."""

    def __init__(self) -> None:
        super().__init__("source")
        self.outputs = {topic: self.create_publisher(kind, topic, SENSOR) for topic, kind in TOPICS}
        self.latencies: list[float] = []  # from publishing a pose to receiving its state [s]
        self.sent_at: dict[int, float] = {}
        self.create_subscription(Odometry, "base/state", self.on_state, sensor())
        self.random = np.random.default_rng(1)

    def on_state(self, message: Odometry) -> None:
        """Record the latency of a state."""
        at = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if at in self.sent_at:
            self.latencies.append(time.monotonic() - self.sent_at.pop(at))

    def frame(self, k: int) -> None:
        """Publish the k-th frame."""
        t, stamp = k * FRAME, time.time_ns()
        header = to_time(stamp)
        imu = Imu()
        imu.header.stamp, imu.angular_velocity.z = header, 0.05
        self.outputs["fog/imu"].publish(imu)
        if k % 5 == 0:
            i = k // 5 % 4
            rate = 0.1 * float(np.sin(t + i))
            joint = JointState(
                name=[f"joint_{i + 1}"], position=[0.1], velocity=[rate], effort=[0.0]
            )
            joint.header.stamp = header
            self.outputs["joint_states"].publish(joint)
            plan = JointTrajectory(joint_names=[f"joint_{j}" for j in range(1, 5)])
            plan.header.stamp = header
            for step in range(6):
                rates = (0.1 * np.sin(t + 0.1 * step + np.arange(4))).tolist()
                point = JointTrajectoryPoint(positions=[0.1] * 4, velocities=rates)
                point.time_from_start.nanosec = step * 100_000_000
                plan.points.append(point)
            self.outputs["arm/planned"].publish(plan)
        if k % 10 == 0:
            command = ThrusterCommand(on_time=[0.02, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.0])
            command.header.stamp = header
            self.outputs["thrusters/pulses"].publish(command)
            gripper = GripperState()
            gripper.header.stamp = header
            self.outputs["gripper/state"].publish(gripper)
        noise = self.random.normal(0.0, 3e-4, 3).tolist()
        target = pose_stamped(stamp, "world", (1.0 + noise[0], 1.0 + noise[1], 0.1 * t))
        self.outputs["vicon/target/target"].publish(target)
        base = pose_stamped(stamp, "world", (0.01 * t + noise[1], noise[2], 0.05 * t))
        self.sent_at[stamp] = time.monotonic()
        self.outputs["vicon/fss/fss"].publish(base)


def processor_time(process: subprocess.Popen[bytes]) -> float:
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def main() -> int:
    """Compare the nodes; return 0 if navigation needs less than a tenth of a core, else 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--listen", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.listen:
        listen()
        return 0
    programs = {
        "navigation": subprocess.Popen([sys.executable, "-m", "fss_gnc.navigation_node"]),
        "listener": subprocess.Popen([sys.executable, __file__, "--listen"]),
    }
    rclpy.init()
    source, due, k = Source(), time.monotonic(), 0
    initial_times: dict[str, float] = {}
    warm = end = inf
    shares = {}
    try:
        while due < end:
            if due > warm and not initial_times:
                initial_times = {
                    name: processor_time(program) for name, program in programs.items()
                }
                source.latencies.clear()
            while (left := due - time.monotonic()) > 0.0:
                rclpy.spin_once(source, timeout_sec=left)
            source.frame(k)
            k, due = k + 1, max(due + FRAME, time.monotonic())
            if source.latencies and end == inf:  # it runs, and may still compile or load kernels
                warm, end = due + 5.0, due + 5.0 + options.seconds
        shares = {
            n: (processor_time(p) - initial_times[n]) / (time.monotonic() - warm)
            for n, p in programs.items()
        }
    finally:
        for program in programs.values():
            program.terminate()
            program.wait()
    for name, share in shares.items():
        print(f"{name}: {100 * share:.1f} % of a core")
    p50, p99 = 1e3 * np.percentile(source.latencies, (50, 99))
    print(f"from pose to base/state: p50 {p50:.2f} ms, p99 {p99:.2f} ms")
    return 0 if shares["navigation"] < 0.1 else 1


if __name__ == "__main__":
    sys.exit(main())
