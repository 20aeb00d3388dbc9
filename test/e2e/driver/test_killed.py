"""A driver that is killed in the midst of a move: the simulated link stops by itself, in time."""

import signal
import time

from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_sim import testbed_node

WATCHDOG = 2.0
KEYS = "".join(f"{i} {i:02x}{'5a' * 19}\n" for i in (1, 2, 3, 4))


class User(Node):
    """Arms link 1 and commands it."""

    def __init__(self):
        super().__init__("user")
        self.telemetry = []
        self.create_subscription(LinkTelemetry, "link_1/telemetry", self.telemetry.append, 100)
        self.command = self.create_publisher(LinkCommand, "link_1/command", 1)
        self.arm = self.create_client(SetBool, "link_1/arm")

    def turn(self):
        """Slowly, and in force for longer than the test."""
        message = LinkCommand(mode=LinkCommand.VELOCITY, set_point=0.1, time_to_live=60.0)
        message.header.stamp = self.get_clock().now().to_msg()
        self.command.publish(message)


def test_a_killed_driver_leaves_a_link_that_stops(spin, start, tmp_path):
    keys = tmp_path / "keys"
    keys.write_text(KEYS)
    keys.chmod(0o600)
    settings = {"ports": [0, 0, 0, 0], "keys": str(keys)}
    bed = testbed_node.TestbedNode(
        parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    user, port = User(), bed.wires[0].port
    driver = start(
        "fss_arm_driver.link_node", "--ros-args", "-p", f"keys:={keys}",
        "-p", f"url:=udp://127.0.0.1:{port}?bind=0", "-p", f"watchdog:={WATCHDOG}",
    )  # fmt: skip
    nodes, plant = [bed, user], bed.testbed.plant
    link = bed.testbed.links[0].electronics
    spin(nodes, lambda: user.telemetry and user.arm.service_is_ready(), 30.0)
    spin(nodes, user.command.get_subscription_count)

    answers = []

    def arm():
        if not answers or answers[-1].done():
            answers.append(user.arm.call_async(SetBool.Request(data=True)))
        return user.telemetry[-1].armed

    spin(nodes, arm, 20.0)
    spin(nodes, lambda: user.turn() or plant.qd[3] > 0.08, 20.0)
    driver.process.send_signal(signal.SIGKILL)
    killed, frame = time.monotonic(), bed.testbed.frame
    driver.wait()
    moving = plant.qd[3]
    spin(nodes, lambda: abs(plant.qd[3]) < 1e-3, WATCHDOG + 10.0)
    simulated = (bed.testbed.frame - frame) * 0.01
    assert moving > 0.08
    assert link.watchdog_tripped
    assert not link.armed
    # The last command may have come right before the kill; then the joint decelerates.
    assert WATCHDOG - 0.3 < simulated < WATCHDOG + 0.3
    assert time.monotonic() - killed > WATCHDOG - 0.3
    assert user.telemetry[-1].flags & State.ARMED  # the last that the dead driver said
