"""Have the node `controller` hold the base at the world's origin; print and plot its error."""

import argparse
import os
from math import atan2, degrees, hypot

import matplotlib.pyplot as plt
import rclpy
from geometry_msgs.msg import Transform
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from fss_arm_msgs.msg import BaseTelemetry


class Judge(Node):
    """Publishes the reference, and collects the base's errors."""

    def __init__(self):
        super().__init__("judge")
        self.errors = []  # time [s], distance [mm] and heading [deg] from the reference
        self.start = None  # time of the first state [s]
        self.reference = self.create_publisher(MultiDOFJointTrajectory, "base/trajectory", 1)
        self.create_timer(0.2, self.publish_reference)
        self.armed = None  # True: the valves may open
        self.create_subscription(Odometry, "base/state", self.on_base, 10)
        self.create_subscription(
            BaseTelemetry, "base/telemetry", self.on_telemetry, qos_profile_sensor_data
        )

    def on_telemetry(self, telemetry):
        """Say if the valves are not armed, or no longer."""
        if not telemetry.armed and self.armed is not False:
            print("the valves are not armed: scripts/fss_arm.sh valves", flush=True)
        self.armed = telemetry.armed

    def publish_reference(self):
        """Publish the origin, at rest; a law receives it for 1 s."""
        point = MultiDOFJointTrajectoryPoint(transforms=[Transform()])
        message = MultiDOFJointTrajectory(joint_names=["fss"], points=[point])
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = "world"
        self.reference.publish(message)

    def on_base(self, state):
        """Collect the error of a state."""
        p, o, stamp = state.pose.pose.position, state.pose.pose.orientation, state.header.stamp
        t = stamp.sec + 1e-9 * stamp.nanosec
        now = 1e-9 * self.get_clock().now().nanoseconds
        if not self.errors and abs(now - t) > 10.0:
            print("base/state has another clock: --ros-args -p use_sim_time:=true", flush=True)
        self.start = self.start or t
        self.errors.append((t - self.start, 1e3 * hypot(p.x, p.y), degrees(2.0 * atan2(o.z, o.w))))


def main():
    """Collect for a while, then print and plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=60.0, help="of the trial [s]")
    parser.add_argument("--output", default="error.png", help="file for the plot")
    options, _ = parser.parse_known_args()  # the others, --ros-args, are ROS's
    rclpy.init()
    judge, due = Judge(), 0.0
    for _ in range(50):
        if not judge.errors:
            rclpy.spin_once(judge, timeout_sec=0.1)
    if not judge.errors:
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        print(f"waiting for base/state in ROS domain {domain}: scripts/fss_up.sh", flush=True)
    print("time [s]  position error [mm]  heading error [deg]")
    while not judge.errors or judge.errors[-1][0] < options.duration:
        rclpy.spin_once(judge)
        if judge.errors and judge.errors[-1][0] >= due:
            print("{:8.1f}  {:19.1f}  {:19.2f}".format(*judge.errors[-1]), flush=True)
            due += 5.0
    rclpy.shutdown()

    times, away, turned = zip(*judge.errors, strict=True)
    _, (top, bottom) = plt.subplots(2, sharex=True)
    top.plot(times, away)
    top.set_ylabel("position error [mm]")
    bottom.plot(times, turned)
    bottom.set_ylabel("heading error [deg]")
    bottom.set_xlabel("time [s]")
    plt.savefig(options.output)


if __name__ == "__main__":
    main()
