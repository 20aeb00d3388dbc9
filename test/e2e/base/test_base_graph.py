"""The real node `base` and the test bed's board: what is asked for moves the base, and no more."""

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import free_port
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from fss_arm_model.thrusters import layout
from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand
from fss_sim.testbed_node import TestbedNode

STEP = 0.01  # of the test bed [s]


class User(Node):
    """Arms the board and opens valves."""

    def __init__(self):
        super().__init__("user")
        self.telemetry, self.pulses, self.imu, self.gripper = [], [], [], []
        self.create_subscription(BaseTelemetry, "base/telemetry", self.telemetry.append, 100)
        self.create_subscription(ThrusterCommand, "thrusters/pulses", self.pulses.append, 100)
        self.create_subscription(Imu, "fog/imu", self.imu.append, 100)
        self.create_subscription(GripperState, "gripper/state", self.gripper.append, 100)
        self.thrust = self.create_publisher(ThrusterCommand, "thrusters/command", 1)
        self.wrench = self.create_publisher(WrenchStamped, "base/wrench", 1)
        self.grip = self.create_publisher(Bool, "gripper/command", 1)
        self.arm = self.create_client(SetBool, "base/arm")

    def command(self, *times):
        message = ThrusterCommand(on_time=[*times, *(8 - len(times)) * [0.0]])
        message.header.stamp = self.get_clock().now().to_msg()
        return message

    def push(self, x, y, torque):
        message = WrenchStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = "fss"
        message.wrench.force.x, message.wrench.force.y = x, y
        message.wrench.torque.z = torque
        self.wrench.publish(message)


class Graph:
    """The test bed's board, its driver as a process, and a user, who has armed it."""

    def __init__(self, spin, start, keys):
        port = free_port()
        settings = {"ports": [0, 0, 0, 0], "board_port": port, "keys": str(keys)}
        settings |= {"preset": "ideal", "table": [8.0, 8.0]}
        overrides = [Parameter(name, value=value) for name, value in settings.items()]
        self.bed, self.user = TestbedNode(parameter_overrides=overrides), User()
        self.spin = spin
        url = f"udp://127.0.0.1:{port}?bind=0"
        start("fss_base_driver.base_node", "--ros-args", "-p", f"url:={url}", "-p", f"keys:={keys}")
        user = self.user
        self.until(lambda: user.telemetry and user.arm.service_is_ready(), 40.0)
        publishers = user.thrust, user.wrench, user.grip
        self.until(lambda: all(p.get_subscription_count() for p in publishers))
        answers = []

        def armed():  # a busy computer may have let the watchdog trip
            if not answers or answers[-1].done():
                answers.append(user.arm.call_async(SetBool.Request(data=True)))
            return user.telemetry[-1].armed

        self.until(armed, 30.0)

    def until(self, condition, timeout=15.0):
        return self.spin([self.bed, self.user], condition, timeout)

    def pass_time(self, seconds):
        frame = self.bed.testbed.frame
        self.until(lambda: self.bed.testbed.frame >= frame + seconds / STEP, 20.0 + 3.0 * seconds)

    @property
    def plant(self):
        return self.bed.testbed.plant

    @property
    def board(self):
        return self.bed.testbed.board.state


@pytest.fixture
def graph(spin, start, keys_file):
    return Graph(spin, start, keys_file({i: bytes([i, *19 * [0x5A]]) for i in range(5)}))


def test_what_is_asked_for_moves_the_base_as_predicted(graph):
    user = graph.user
    assert not graph.bed.get_publishers_info_by_topic("fog/imu")[1:]  # one alone
    user.thrust.publish(user.command(0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2))
    graph.until(lambda: graph.board.opened[0])
    graph.until(lambda: not any(graph.plant.valves))
    graph.pass_time(0.05)  # the frame that is being made is whole
    np.testing.assert_allclose(graph.plant.audit.impulse[:2], [-2 * 0.16 * 0.2, 0.0], atol=1e-3)
    graph.until(lambda: user.pulses)
    times = [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0]
    assert user.pulses[0].on_time.tolist() == pytest.approx(times)

    before, frame = np.array(graph.plant.audit.momentum), graph.bed.testbed.frame
    before_opened = np.array(graph.board.opened)
    graph.until(lambda: user.push(0.04, 0.03, 0.0) or graph.bed.testbed.frame - frame >= 300)
    lasted = (graph.bed.testbed.frame - frame) * STEP
    graph.pass_time(1.0)
    gained = np.array(graph.plant.audit.momentum) - before
    for got, wanted in zip(gained[:2], (0.04, 0.03), strict=True):
        # A busy computer lets some wrenches grow too old: what was opened is what was given.
        assert 0.2 * lasted * wanted < got < (lasted + 0.5) * wanted
    opened = 1e-6 * (np.array(graph.board.opened) - before_opened)
    np.testing.assert_allclose(gained[:2], opened @ layout(0.16, 0.11)[:, :2], atol=0.01)
    graph.until(lambda: abs(user.imu[-1].angular_velocity.z - graph.plant.qd[2]) < 1e-3)
    user.grip.publish(Bool(data=True))
    graph.until(lambda: graph.plant.closed and user.gripper[-1].closed)
