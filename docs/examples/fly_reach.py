"""Compare the policy of train_reach.py and the generalized Jacobian on the test bed.

    python fly_reach.py reach.npz --arm config/truth.yaml --ros-args -p use_sim_time:=true

Each flight moves the joints to a start, with the base floating, and then brings the end effector to
the pose that a motion to another posture would give it. The laws know base/state and
arm/joint_states and command arm/joint_commands; sim/truth is the judge, by the limits of Reach.
"""

import argparse
from collections.abc import Iterator
from math import atan2

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState
from train_reach import GAIN, Law, jacobian_law, limited, load

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_msgs.msg import SimTruth
from fss_arm_ros.lockstep import report_reached_time
from fss_sim.environments.batch import rotated, wrapped
from fss_sim.environments.tasks import after_motion

MAX_ANGLE = 0.9  # of starts and of the postures for fixtures [rad]
START_RATE = 0.3  # of the joints to a start [rad/s]
MAX_AGE = 0.3  # of the base's state, for a command [s]
TIMEOUT, SETTLING_TIME = 30.0, 2.0  # until and after the arrival [s]


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


class FlyReach(Node):
    """Flies each law from each start; `done` when all have ended."""

    def __init__(self, arm: Arm, laws: dict[str, Law], starts: int) -> None:
        super().__init__("fly_reach")
        self.p, self.n, self.laws, self.starts = arm.vector(), arm.n, laws, starts
        self.max_rate = np.array([link.drive.max_velocity for link in arm.links])
        self.state = np.zeros(3 + arm.n)  # as measured
        self.base_time = self.time = 0.0  # of the base's and the joints' state [s]
        self.fixture, self.begin = np.zeros(3), 0.0  # of the present flight; its start [s]
        self.truths: list[tuple[float, np.ndarray, np.ndarray]] = []  # of it: time, error, torque
        self.arrival: float | None = None  # [s] after its start
        self.flights, self.done = self.fly(), False
        heads = "start", "distance [mm]", "arrival [s]", "error [mm]", "rms torque [N m]", "largest"
        self.table = Table("law", *heads)
        self.commands = self.create_publisher(JointState, "arm/joint_commands", 1)
        self.create_subscription(Odometry, "base/state", self.on_base, 1)
        self.create_subscription(JointState, "arm/joint_states", self.on_joints, 1)
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, qos_profile_sensor_data)
        report_reached_time(self)  # in lockstep the simulator waits for this node, too

    def on_base(self, message: Odometry) -> None:
        """Store the base's pose."""
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        self.state[:3] = place.x, place.y, 2.0 * atan2(turn.z, turn.w)
        self.base_time = seconds(message.header.stamp)

    def on_joints(self, message: JointState) -> None:
        """Store the joints' angles, and command their rates."""
        order = [message.name.index(f"joint_{i + 1}") for i in range(self.n)]
        self.state[3:] = np.array(message.position)[order]
        self.time = seconds(message.header.stamp)
        if self.done or self.time - self.base_time > MAX_AGE:
            return  # the joints stop
        rates = next(self.flights, None)
        self.done = rates is None
        if rates is not None:
            command = JointState(name=[message.name[i] for i in order], velocity=rates.tolist())
            command.header.stamp = self.get_clock().now().to_msg()
            self.commands.publish(command)

    def on_truth(self, message: SimTruth) -> None:
        """Collect error and torques of the present flight."""
        q, qd = np.array(message.q), np.array(message.qd)
        time = seconds(message.header.stamp) - self.begin
        error = self.fixture - tip_pose(self.p, q)
        speed = np.hypot(*(tip_jacobian(self.p, q) @ qd)[:2])
        distance, turn = np.hypot(*error[:2]), abs(float(wrapped(error[2])))
        self.truths.append((time, distance, np.array(message.torque)))
        if self.arrival is None and distance < 0.01 and turn < 0.05 and speed < 0.02:
            self.arrival = time

    def fly(self) -> Iterator[np.ndarray]:
        """Yield the joints' rates [rad/s] of all flights, one at each state of the joints."""
        rng = np.random.default_rng(3)
        for k in range(1, self.starts + 1):
            start, posture = rng.uniform(-MAX_ANGLE, MAX_ANGLE, (2, self.n))
            for name, law in self.laws.items():
                yield from self.move(start)
                there = after_motion(self.p[None], self.state[None], posture[None])[0]
                self.fixture, self.begin = tip_pose(self.p, there), self.time
                self.truths, self.arrival = [], None
                while self.time - self.begin < (
                    TIMEOUT if self.arrival is None else self.arrival + SETTLING_TIME
                ):
                    error = (self.fixture - tip_pose(self.p, self.state))[None]
                    yield law(self.state[None, 3:], rotated(error, -self.state[2:3]))[0]
                self.report(name, k)

    def move(self, posture: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the rates to a posture, until the arm has been there for 1 s."""
        away = self.time
        while self.time - away < 1.0 or np.abs(posture - self.state[3:]).max() > 0.005:
            travel = posture - self.state[3:]
            if np.abs(travel).max() > 0.005:
                away = self.time
            yield limited(GAIN * travel[None], np.full(self.n, START_RATE))[0]

    def report(self, law: str, start: int) -> None:
        """Add the present flight to the table."""
        flown = [torque for time, _, torque in self.truths if time <= (self.arrival or TIMEOUT)]
        torque, distances = np.array(flown), [1e3 * self.truths[k][1] for k in (0, -1)]
        arrival = "none" if self.arrival is None else f"{self.arrival:.1f}"
        rms, largest = np.sqrt(np.mean(torque**2)), np.abs(torque).max()
        away, error = (f"{distance:.1f}" for distance in distances)
        row = law, str(start), away, arrival, error, f"{rms:.3f}", f"{largest:.2f}"
        self.table.add_row(*row)
        print(*row, flush=True)


def main() -> None:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", help="file written by train_reach.py")
    parser.add_argument("--arm", default="paper", help="paper, cad, truth (simulator) or a file")
    parser.add_argument("--starts", type=int, default=6, help="number of flights of each law")
    options, _ = parser.parse_known_args()  # the others, --ros-args, are ROS's
    arm = described(options.arm)
    laws = {"policy": load(options.policy), "Jacobian": jacobian_law(arm)}
    rclpy.init()
    node = FlyReach(arm, laws, options.starts)
    while not node.done:
        rclpy.spin_once(node)
    rclpy.shutdown()
    Console().print(node.table)


if __name__ == "__main__":
    main()
