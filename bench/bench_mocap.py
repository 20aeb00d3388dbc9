"""Latency of `mocap` from a server's frame to a subscriber, compared with a bare Python receiver.

A small NatNet server sends two subjects at 100 Hz. The node receives them through the
motion-capture library in a separate process. The peer is an rclpy node that receives the same
frames on its own socket and publishes the numbers of the datagram unchanged. Both run at the same
time, and a third process subscribes to both.
"""

import argparse
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import cos, inf, sin
from pathlib import Path
from socket import AF_INET, SOCK_DGRAM, socket

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from fss_arm_ros.qos import SENSOR, subscribe_sensor

sys.path.append(str(Path(__file__).parents[1] / "test/support"))
from natnet import NatNetServer, frame

NAMES = ["fss", "end_effector"]
RATE = 100.0  # of the frames [1/s]
BODIES = 20  # their offset in a datagram: after its header and three counts


def relay(port: int) -> None:
    """Publish the poses received at a port."""
    rclpy.init()
    node = Node("relay")
    publishers = [node.create_publisher(PoseStamped, f"bare/{n}/{n}", SENSOR) for n in NAMES]
    link = socket(AF_INET, SOCK_DGRAM)
    link.bind(("127.0.0.1", port))
    link.settimeout(0.2)
    while rclpy.ok():
        with suppress(TimeoutError):
            data, _ = link.recvfrom(4096)
            for k, publisher in enumerate(publishers):
                x, y, z, *turn = struct.unpack_from("<4x7f", data, BODIES + 38 * k)
                message = PoseStamped()
                message.header.stamp = node.get_clock().now().to_msg()
                p, o = message.pose.position, message.pose.orientation
                p.x, p.y, p.z, o.x, o.y, o.z, o.w = x, y, z, *turn
                publisher.publish(message)


class User(Node):
    """Records the arrival of each subject's poses, by their z, which counts the frames."""

    def __init__(self) -> None:
        super().__init__("user")
        self.arrivals: dict[str, dict[int, float]] = {"vicon": {}, "bare": {}}
        for prefix, arrivals in self.arrivals.items():
            for name in NAMES[1:]:  # the second one of a frame
                subscribe_sensor(
                    self,
                    PoseStamped,
                    f"{prefix}/{name}/{name}",
                    lambda m, arrivals=arrivals: arrivals.setdefault(
                        round(1e3 * m.pose.position.z), time.monotonic()
                    ),
                )


def run(user: User, send: Sequence[Callable[[bytes], object]], seconds: float) -> dict[int, float]:
    """Send frames to both, in alternating order, for `seconds`; return the times of sending."""
    sent: dict[int, float] = {}
    due, end = time.monotonic(), inf
    while due < end:
        while (left := due - time.monotonic()) > 0.0:
            rclpy.spin_once(user, timeout_sec=left)
        number = len(sent) + 1
        turn = 0.0, 0.0, sin(1e-3 * number), cos(1e-3 * number)
        poses = {name: (x, 0.0, 1e-3 * number, *turn) for x, name in enumerate(NAMES)}
        sent[number] = time.monotonic()
        for send_one in send[:: 1 if number % 2 else -1]:
            send_one(frame(number, NAMES, poses))
        due += 1.0 / RATE
        if end == inf and all(user.arrivals.values()):
            end = due + seconds
    return dict(list(sent.items())[-round(seconds * RATE) :])


def compare(seconds: float) -> None:
    """Print both latencies and their ratio."""
    server, link = NatNetServer(NAMES), socket(AF_INET, SOCK_DGRAM)
    with socket(AF_INET, SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        relay_address = free.getsockname()
    parameters = {"system": "optitrack", "host": "127.0.0.1", "max_speed": 1000.0}
    options = [f"{name}:={value}" for name, value in parameters.items()]
    options.append(f'options:=["{server.options[0]}"]')
    node = [sys.executable, "-m", "fss_base_driver.mocap_node", "--ros-args"]
    programs = [
        subprocess.Popen([*node, *(word for option in options for word in ("-p", option))]),
        subprocess.Popen([sys.executable, __file__, "--relay", str(relay_address[1])]),
    ]
    rclpy.init()
    user = User()
    try:
        sent = run(user, (server.send_raw, lambda data: link.sendto(data, relay_address)), seconds)
    finally:
        for program in programs:
            program.terminate()
            program.wait()
    latencies = {}
    for prefix, arrivals in user.arrivals.items():
        times = [arrivals[number] - then for number, then in sent.items() if number in arrivals]
        latencies[prefix] = p50, p99 = np.percentile(1e3 * np.array(times), (50, 99))
        print(f"{prefix}: p50 {p50:.2f} ms, p99 {p99:.2f} ms, {len(sent) - len(times)} lost")
    p50, p99 = np.divide(latencies["vicon"], latencies["bare"])
    print(f"mocap / bare: p50 {p50:.2f}, p99 {p99:.2f}")


def main() -> None:
    """Compare the nodes, or run the peer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--relay", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.relay:
        relay(options.relay)
    else:
        compare(options.seconds)


if __name__ == "__main__":
    main()
