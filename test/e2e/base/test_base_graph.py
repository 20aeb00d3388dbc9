"""The real node `base` and the test bed's board: what is asked for moves the base, and no more."""

import signal

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import free_port
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool, Empty
from std_srvs.srv import SetBool

from fss_arm_model.thrusters import layout
from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand
from fss_base_driver.protocol import BaseState
from fss_sim.testbed_node import TestbedNode

WATCHDOG = 0.5
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
        self.stop = self.create_publisher(Empty, "arm/stop", 10)
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
    def __init__(self, spin, start, tmp_path, by="udp"):
        port, line = free_port(), tmp_path / "board"
        keys = tmp_path / "keys"
        keys.write_text("".join(f"{i} {i:02x}{'5a' * 19}\n" for i in range(5)))
        keys.chmod(0o600)
        settings = {"ports": [0, 0, 0, 0], "board_port": port, "keys": str(keys)}
        settings |= {"preset": "ideal", "table": [8.0, 8.0]}
        settings |= {"serial": {"board_terminal": str(line)}, "tcp": {"board_transport": by}}.get(
            by, {}
        )
        there = {"serial": line, "tcp": f"127.0.0.1:{port}"}.get(by, f"127.0.0.1:{port}?bind=0")
        overrides = [Parameter(name, value=value) for name, value in settings.items()]
        self.bed, self.user = TestbedNode(parameter_overrides=overrides), User()
        self.spin, self.start = spin, start
        self.options = [
            "--ros-args", "-p", f"url:={by}://{there}", "-p", f"keys:={keys}",
            "-p", f"watchdog:={WATCHDOG}",
        ]  # fmt: skip
        self.driver = self.begin()
        self.until(lambda: self.user.telemetry and self.user.arm.service_is_ready(), 40.0)
        user = self.user
        publishers = user.thrust, user.wrench, user.grip, user.stop
        self.until(lambda: all(p.get_subscription_count() for p in publishers))

    def begin(self):
        return self.start("fss_base_driver.base_node", *self.options)

    def until(self, condition, timeout=15.0):
        return self.spin([self.bed, self.user], condition, timeout)

    def pass_time(self, seconds):
        frame = self.bed.testbed.frame
        self.until(lambda: self.bed.testbed.frame >= frame + seconds / STEP, 20.0 + 3.0 * seconds)

    def arm(self):
        """Ask until it is; a busy computer may have let the watchdog trip."""
        answers = []

        def ask():
            if not answers or answers[-1].done():
                answers.append(self.user.arm.call_async(SetBool.Request(data=True)))
            return self.user.telemetry[-1].armed

        self.until(ask, 30.0)
        return self

    @property
    def plant(self):
        return self.bed.testbed.plant

    @property
    def board(self):
        return self.bed.testbed.board.state


@pytest.fixture
def graph(spin, start, tmp_path):
    return Graph(spin, start, tmp_path)


def test_what_is_asked_for_moves_the_base_as_predicted(graph):
    user = graph.arm().user
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


@pytest.mark.parametrize("by", ["tcp", "serial"])
def test_the_board_is_reached_by_other_lines(spin, start, tmp_path, by):
    graph = Graph(spin, start, tmp_path, by).arm()
    graph.user.thrust.publish(graph.user.command(0.2))
    graph.until(lambda: graph.board.opened[0] == 200_000)
    assert graph.board.opened[1:] == 7 * [0]


def test_a_killed_node_leaves_valves_that_close(graph):
    user = graph.arm().user
    user.thrust.publish(user.command(*8 * [1.0]))
    graph.until(lambda: all(graph.plant.valves))
    graph.driver.process.send_signal(signal.SIGKILL)
    frame = graph.bed.testbed.frame
    graph.driver.wait()
    graph.until(lambda: not any(graph.plant.valves))
    assert (graph.bed.testbed.frame - frame) * STEP < WATCHDOG + 0.05
    assert graph.board.flags() == BaseState.WATCHDOG
    assert max(graph.board.opened) < 950_000  # before the pulse would have ended
    graph.driver = graph.begin()  # the next one finds it, disarmed, and opens nothing
    told = len(user.telemetry)
    graph.until(lambda: len(user.telemetry) > told + 5, 40.0)
    opened = list(graph.board.opened)
    graph.pass_time(1.0)
    assert graph.board.opened == opened
    graph.until(lambda: user.arm.service_is_ready() and user.thrust.get_subscription_count())
    pulse = graph.board.pulse
    graph.arm()
    user.thrust.publish(user.command(0.1))
    graph.until(lambda: graph.board.pulse == pulse + 1)


def test_the_arms_stop_closes_the_bases_valves(graph):
    user = graph.arm().user
    user.thrust.publish(user.command(*8 * [1.0]))
    graph.until(lambda: all(graph.plant.valves))
    user.stop.publish(Empty())
    graph.until(lambda: not any(graph.plant.valves))
    assert max(graph.board.opened) < 900_000
    graph.until(lambda: user.telemetry[-1].flags == BaseState.STOPPED)


def test_a_replayed_bag_opens_no_valve(graph):
    """As `ros2 bag play` publishes it; our own replay does not play such topics at all."""
    user = graph.arm().user
    recorded = [user.command(*8 * [0.5]) for _ in range(20)]
    for message in recorded[::2]:
        message.header.stamp.sec = message.header.stamp.nanosec = 0  # nobody said when
    wrench = WrenchStamped()
    wrench.header.stamp = user.get_clock().now().to_msg()
    wrench.header.frame_id = "fss"
    wrench.wrench.force.x = 1.0
    graph.pass_time(1.0)
    for message in recorded:
        user.thrust.publish(message)
        user.wrench.publish(wrench)
        graph.pass_time(0.05)
    user.thrust.publish(user.command(0.0, 0.1))  # a live one is received among them
    graph.until(lambda: graph.board.opened[1] == 100_000)
    assert graph.board.opened == [0, 100_000, *6 * [0]]
    assert graph.board.pulse == 1
