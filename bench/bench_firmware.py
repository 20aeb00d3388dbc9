"""Tracking error of the firmware on paths (python bench/bench_firmware.py [RUNS]).

Four links run the firmware compiled for this computer (`fss_link`, over UDP, in real time); drivers
and `arm` run as nodes. Each link and run has a different path of 10 s and 6 knots, sent as
`arm_controller/follow_joint_trajectory` one second before its start. The error is the encoder
reading minus the path at the time of the reading. The simulated drive is ideal.
"""

import random
import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp
from time import monotonic

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from running import OWN  # enters a ROS domain of its own: before rclpy

import rclpy  # isort: skip
from bench_paths import TIMES, random_knots  # isort: skip
from control_msgs.action import FollowJointTrajectory  # isort: skip
from driver_path import path_at  # isort: skip
from firmware import build  # isort: skip
from rclpy.action import ActionClient  # isort: skip
from rclpy.duration import Duration  # isort: skip
from rclpy.node import Node  # isort: skip
from sensor_msgs.msg import JointState  # isort: skip
from std_srvs.srv import SetBool  # isort: skip
from trajectory_msgs.msg import JointTrajectoryPoint  # isort: skip
from unique_identifier_msgs.msg import UUID  # isort: skip

from fss_arm_ros.convert import SECOND, joint_readings, stamp_ns, to_time
from fss_arm_ros.qos import subscribe_sensor
from fss_rehearsal.processes import Nodes

PATH_LEAD = SECOND  # from sending a path to its start [ns]


class Operator(Node):
    """Arms the links, sends paths, records joint states."""

    def __init__(self):
        super().__init__("operator")
        self.readings = []  # time [ns], joint from 0, angle [rad]
        self.arm_client = self.create_client(SetBool, "arm/enable")
        action = "arm_controller/follow_joint_trajectory"
        self.controller = ActionClient(self, FollowJointTrajectory, action)
        self.goals = []  # id of the goal that is followed
        self.alive = self.create_publisher(UUID, "arm_controller/alive", 1)
        self.create_timer(0.2, lambda: [self.alive.publish(goal) for goal in self.goals])
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)

    def on_joints(self, message):
        """Record the readings of one link."""
        t = stamp_ns(message.header.stamp)
        self.readings += [(t, i - 1, q) for i, q, _, _ in joint_readings(message)]

    def after(self, future, timeout=60.0):
        """Wait for a future; return its result."""
        rclpy.spin_until_future_complete(self, future, timeout_sec=timeout)
        if not future.done():
            raise TimeoutError(f"no result within {timeout} s")
        return future.result()

    def arm_links(self):
        """Arm all links."""
        self.arm_client.wait_for_service(60.0)
        self.controller.wait_for_server(60.0)
        deadline = monotonic() + 60.0
        request = SetBool.Request(data=True)
        while not (answer := self.after(self.arm_client.call_async(request))).success:
            if monotonic() > deadline:
                raise TimeoutError(answer.message)

    def follow_paths(self, paths):
        """Let all joints follow paths; return the errors [deg]."""
        goal = FollowJointTrajectory.Goal()
        start = self.get_clock().now().nanoseconds + PATH_LEAD
        goal.trajectory.header.stamp = to_time(start)
        goal.trajectory.joint_names = [f"joint_{i + 1}" for i in range(len(paths))]
        for t, *knot in zip(TIMES, *(zip(*path, strict=True) for path in paths), strict=True):
            q, qd = zip(*knot, strict=True)
            goal.trajectory.points.append(
                JointTrajectoryPoint(
                    positions=q, velocities=qd, time_from_start=Duration(seconds=t).to_msg()
                )
            )
        self.readings.clear()
        handle = self.after(self.controller.send_goal_async(goal))
        if not handle.accepted:
            raise RuntimeError("the path was rejected")
        self.goals = [handle.goal_id]
        result = self.after(handle.get_result_async()).result
        if result.error_code:
            raise RuntimeError(result.error_string)
        return [
            abs(np.degrees(q - path_at(t, TIMES, *paths[i])))
            for at, i, q in self.readings
            if 0.0 <= (t := (at - start) / SECOND) <= TIMES[-1]
        ]


def main():
    runs, rng = int(sys.argv[1]) if len(sys.argv) > 1 else 5, random.Random(1)
    program, ports = build("fss_link"), OWN.ports(4)
    links = [
        subprocess.Popen([program, "--link", str(i), "--udp", str(port)], stdout=subprocess.DEVNULL)
        for i, port in enumerate(ports, 1)
    ]
    rclpy.init()
    operator = Operator()
    try:
        with Nodes(Path(mkdtemp(prefix="bench_firmware_")), print, OWN) as nodes:
            nodes.start("links", "fss_arm_driver", "link", urls=OWN.urls(4))
            nodes.start("arm", "fss_arm_driver", "arm")
            operator.arm_links()
            errors = []
            for _ in range(runs):
                errors += operator.follow_paths([random_knots(rng) for _ in links])
    finally:
        operator.controller.destroy()
        operator.destroy_node()
        rclpy.shutdown()
        for link in links:
            link.kill()
    p50, p99, largest = np.percentile(errors, [50.0, 99.0, 100.0])
    print(
        f"{runs} runs of {len(links)} links, {len(errors)} readings: tracking error "
        f"{p50:.4f} deg (p50), {p99:.4f} (p99), {largest:.4f} (largest)"
    )


if __name__ == "__main__":
    main()
