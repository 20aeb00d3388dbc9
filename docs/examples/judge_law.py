"""Have the node `controller` hold the base at the world's origin; print and plot its error."""

import argparse
import os
import sys
import time
from math import atan2, degrees, hypot, isnan, nan

import matplotlib.pyplot as plt
import rclpy
from geometry_msgs.msg import Transform
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.utilities import remove_ros_args
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from fss_arm_msgs.msg import BaseTelemetry, SimTruth

MAX_CLOCK_DIFFERENCE = 10.0  # between a state's stamp and this node's clock [s]


class Judge(Node):
    """Publishes the reference, and collects the base's errors."""

    def __init__(self):
        super().__init__("judge")
        self.rows = []  # time [s], errors of position [mm] and heading [deg], propellant [g]
        self.start = None  # time of the first state [s]
        self.has_other_clock = False  # True if the last state's stamp is of another clock
        self.used = self.used_before = nan  # propellant in simulation, now and at the start [g]
        self.armed = None  # True: the valves may open
        self.reference = self.create_publisher(MultiDOFJointTrajectory, "base/trajectory", 1)
        self.create_timer(0.2, self.publish_reference)
        sensor = qos_profile_sensor_data
        self.create_subscription(Odometry, "base/state", self.on_base, 10)
        self.create_subscription(BaseTelemetry, "base/telemetry", self.on_telemetry, sensor)
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, sensor)

    def on_telemetry(self, telemetry):
        """Say if the valves are not armed, or no longer."""
        if not telemetry.armed and self.armed is not False:
            print("the valves are not armed: scripts/fss_arm.sh valves", flush=True)
        self.armed = telemetry.armed

    def on_truth(self, truth):
        """Store the propellant that the simulator's base has used."""
        self.used = 1e3 * truth.propellant

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
        self.has_other_clock = abs(now - t) > MAX_CLOCK_DIFFERENCE
        if self.has_other_clock:
            return
        self.start = t if self.start is None else self.start
        self.used_before = self.used if isnan(self.used_before) else self.used_before
        heading = degrees(2.0 * atan2(o.z, o.w))
        turned = (heading + 180.0) % 360.0 - 180.0
        used = self.used - self.used_before
        self.rows.append((t - self.start, 1e3 * hypot(p.x, p.y), turned, used))

    def wait_for_row(self, timeout):
        """Spin until another state is collected.

        Raises:
            SystemExit: there is none within the timeout [s] of real time; with the remedy.
        """
        known, end = len(self.rows), time.monotonic() + timeout
        while len(self.rows) == known:
            rclpy.spin_once(self, timeout_sec=0.1)
            if time.monotonic() > end:
                raise SystemExit(f"judge_law.py: {self.describe_problem()}")

    def describe_problem(self):
        """Return why there are no states, and the remedy."""
        if not self.has_other_clock:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            return f"no base/state in ROS domain {domain}: scripts/fss_up.sh, fss_status.sh"
        if self.get_parameter("use_sim_time").value:
            return "base/state has the computer's clock: leave out use_sim_time"
        return "base/state has the simulated clock: add --ros-args -p use_sim_time:=true"


def print_row(t, away, turned, used):
    """Print the errors at a time, and the propellant if it is known."""
    propellant = "unknown" if isnan(used) else f"{used:.3f}"
    print(f"{t:8.1f}  {away:19.1f}  {turned:19.2f}  {propellant:>14}", flush=True)


def main():
    """Collect for a while, then print and plot; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=60.0, help="of the trial [s]")
    parser.add_argument("--output", default="error.png", help="file for the plot")
    parser.add_argument("--wait", type=float, default=10.0, help="timeout of base/state [s]")
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    rclpy.init()
    judge, due = Judge(), 0.0
    try:
        judge.wait_for_row(options.wait)
        print("time [s]  position error [mm]  heading error [deg]  propellant [g]")
        while judge.rows[-1][0] < options.duration:
            if judge.rows[-1][0] >= due:
                print_row(*judge.rows[-1])
                due += 5.0
            judge.wait_for_row(options.wait)
    except (KeyboardInterrupt, ExternalShutdownException):
        return 130
    print_row(*judge.rows[-1])

    times, away, turned, _ = zip(*judge.rows, strict=True)
    _, (top, bottom) = plt.subplots(2, sharex=True)
    top.plot(times, away)
    top.set_ylabel("position error [mm]")
    bottom.plot(times, turned)
    bottom.set_ylabel("heading error [deg]")
    bottom.set_xlabel("time [s]")
    plt.savefig(options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
