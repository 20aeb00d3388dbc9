"""How closely the firmware follows a path (python bench/bench_firmware.py [RUNS]).

Four links of its program for this computer (`fss_link`, over UDP, in real time), drivers and `arm`
as nodes, and a path of 10 s and 6 knots, others for each link and run, given as
`arm_controller/follow_joint_trajectory` a second before it begins. Off the path: what the link's
encoder says at the time it says it. The simulated drive is ideal.
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
from bench_paths import TIMES, knots  # isort: skip
from control_msgs.action import FollowJointTrajectory  # isort: skip
from driver_path import path_at  # isort: skip
from firmware import build  # isort: skip
from rclpy.action import ActionClient  # isort: skip
from rclpy.duration import Duration  # isort: skip
from rclpy.node import Node  # isort: skip
from sensor_msgs.msg import JointState  # isort: skip
from std_srvs.srv import SetBool  # isort: skip
from trajectory_msgs.msg import JointTrajectoryPoint  # isort: skip

from fss_arm_ros.convert import SECOND, joint_readings, stamp_ns, to_time
from fss_arm_ros.qos import subscribe_sensor
from fss_rehearsal.processes import Nodes

LEAD = SECOND  # from a path to its begin [ns]


class Person(Node):
    """Arms the links, gives paths, keeps what joints say."""

    def __init__(self):
        super().__init__("person")
        self.readings = []  # time [ns], joint from 0, angle [rad]
        self.armer = self.create_client(SetBool, "arm/enable")
        action = "arm_controller/follow_joint_trajectory"
        self.controller = ActionClient(self, FollowJointTrajectory, action)
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)

    def on_joints(self, message):
        """One link's."""
        t = stamp_ns(message.header.stamp)
        self.readings += [(t, i - 1, q) for i, q, _, _ in joint_readings(message)]

    def after(self, future, timeout=60.0):
        """What a future gives."""
        rclpy.spin_until_future_complete(self, future, timeout_sec=timeout)
        if not future.done():
            raise TimeoutError(f"not within {timeout} s")
        return future.result()

    def begin(self):
        """Arm all links."""
        self.armer.wait_for_service(60.0)
        self.controller.wait_for_server(60.0)
        deadline = monotonic() + 60.0
        while not (done := self.after(self.armer.call_async(SetBool.Request(data=True)))).success:
            if monotonic() > deadline:
                raise TimeoutError(done.message)

    def follow(self, paths):
        """Errors of all joints on their paths [deg]."""
        goal = FollowJointTrajectory.Goal()
        begin = self.get_clock().now().nanoseconds + LEAD
        goal.trajectory.header.stamp = to_time(begin)
        goal.trajectory.joint_names = [f"joint_{i + 1}" for i in range(len(paths))]
        for t, *knot in zip(TIMES, *(zip(*path, strict=True) for path in paths), strict=True):
            q, qd = zip(*knot, strict=True)
            goal.trajectory.points.append(JointTrajectoryPoint(
                positions=q, velocities=qd, time_from_start=Duration(seconds=t).to_msg(),
            ))  # fmt: skip
        self.readings.clear()
        handle = self.after(self.controller.send_goal_async(goal))
        if not handle.accepted:
            raise RuntimeError("the path was rejected")
        result = self.after(handle.get_result_async()).result
        if result.error_code:
            raise RuntimeError(result.error_string)
        return [
            abs(np.degrees(q - path_at(t, TIMES, *paths[i])))
            for at, i, q in self.readings
            if 0.0 <= (t := (at - begin) / SECOND) <= TIMES[-1]
        ]


def main():
    runs, rng = int(sys.argv[1]) if len(sys.argv) > 1 else 5, random.Random(1)
    program, ports = build("fss_link"), OWN.ports(4)
    links = [
        subprocess.Popen([program, "--link", str(i), "--udp", str(port)], stdout=subprocess.DEVNULL)
        for i, port in enumerate(ports, 1)
    ]
    rclpy.init()
    person = Person()
    try:
        with Nodes(Path(mkdtemp(prefix="bench_firmware_")), print, OWN) as nodes:
            nodes.start("links", "fss_arm_driver", "link", urls=OWN.urls(4))
            nodes.start("arm", "fss_arm_driver", "arm")
            person.begin()
            errors = [e for _ in range(runs) for e in person.follow([knots(rng) for _ in links])]
    finally:
        person.controller.destroy()
        person.destroy_node()
        rclpy.shutdown()
        for link in links:
            link.kill()
    p50, p99, most = np.percentile(errors, [50.0, 99.0, 100.0])
    print(f"{runs} runs of {len(links)} links, {len(errors)} readings: off the path by "
          f"{p50:.4f} deg (p50), {p99:.4f} (p99), {most:.4f} (largest)")  # fmt: skip


if __name__ == "__main__":
    main()
