"""What the driver costs: from datagram to joint_states, beside a bare relay; share of a core.

The relay is an rclpy node that waits for its datagrams in the same way, copies one float out of
each into a std_msgs/Float64, and does nothing else. Both run at once, as processes of their own,
and get their datagrams in turn. Then one process drives four links at several rates.
"""

import argparse
import os
import signal
import socket
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from threading import Thread

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from fss_arm_driver.protocol import Mode, Slow, State, Telemetry, encode
from fss_arm_driver.receiver import Receiver
from fss_arm_driver.transport import UdpTransport
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR, sensor

LIMIT = 1.3  # of the driver's latency to the relay's
RATES = (5.0, 100.0, 500.0)
TELEMETRY = tuple((LinkTelemetry, f"link_{i}/telemetry") for i in (1, 2, 3, 4))
FRAME = Telemetry(
    link=1, flags=State.REFERENCED, boot=3, sequence=0, clock=0, echo=0, turnaround=0, position=0,
    velocity=0, current=0, mode=Mode.OFF, slow_id=Slow.SUPPLY, status=0, torque=0, torque_age=3,
    slow_value=240,
)  # fmt: skip


class RelayNode(Node):
    """Copies a float from each datagram to a topic."""

    def __init__(self, peer: int, port: int) -> None:
        super().__init__("relay")
        self.transport = UdpTransport("127.0.0.1", peer, port)
        self.publisher = self.create_publisher(Float64, "relayed", SENSOR)
        self.receiver = Receiver(self.transport, self.poll, self.create_guard_condition(exit))

    def poll(self) -> None:
        """Copy what has come."""
        for data in self.transport.receive():
            self.publisher.publish(Float64(data=struct.unpack("<d", data[:8])[0]))


class Peer:
    """The far end of a UDP transport."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port: int = self.socket.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.home: int = free.getsockname()[1]

    @property
    def url(self) -> str:
        """As the driver has it."""
        return f"udp://127.0.0.1:{self.port}?bind={self.home}"

    def send(self, data: bytes) -> None:
        """Send to the driver's side."""
        self.socket.sendto(data, ("127.0.0.1", self.home))


class FakeLink(Peer):
    """A link that measures on demand."""

    def __init__(self, number: int = 1) -> None:
        super().__init__()
        self.frame = replace(FRAME, link=number)

    def measure(self, at: float | None = None) -> bytes:
        """The frame measured at a time [s], now by default."""
        clock = round(1e6 * (time.monotonic() if at is None else at))
        self.frame = replace(self.frame, sequence=self.frame.sequence + 1, clock=clock)
        return encode(self.frame)


def start(*code_and_arguments: str) -> subprocess.Popen[bytes]:
    """A Python process."""
    return subprocess.Popen([sys.executable, "-c", *code_and_arguments])


def start_driver(*parameters: str) -> subprocess.Popen[bytes]:
    code = "import sys; from fss_arm_driver.link_node import main; sys.exit(main())"
    given = [word for parameter in parameters for word in ("-p", parameter)]
    return start(code, "--ros-args", *given)


def latencies(samples: int, rate: float) -> tuple[list[float], list[float]]:
    """Of the driver and of the relay [s], each asked `samples` times, in turn."""
    link, peer = FakeLink(), Peer()
    code = f"from bench_driver import relay; relay({peer.port}, {peer.home})"
    processes = [start_driver(f"url:={link.url}"), start(code)]
    node = Node("bench_driver")
    came: dict[str, float] = {}
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for kind, topic in ((JointState, "joint_states"), (Float64, "relayed")):
        node.create_subscription(
            kind, topic, lambda _, topic=topic: came.setdefault(topic, time.perf_counter()),
            sensor(), raw=True,
        )  # fmt: skip

    def once(topic: str, end: Peer, data: bytes, timeout: float) -> float:
        came.pop(topic, None)
        begun = time.perf_counter()
        end.send(data)
        while topic not in came and time.perf_counter() - begun < timeout:
            executor.spin_once(timeout_sec=0.01)
        return came.get(topic, float("inf")) - begun

    ways: tuple[tuple[str, Peer, Callable[[], bytes]], ...] = (
        ("joint_states", link, link.measure),
        ("relayed", peer, lambda: struct.pack("<9d", *9 * [1.0])),
    )
    try:
        for topic, end, make in ways:
            deadline = time.monotonic() + 20.0
            while once(topic, end, make(), 0.1) == float("inf"):
                if time.monotonic() > deadline:
                    raise RuntimeError(f"nothing on {topic}")
        results: dict[str, list[float]] = {topic: [] for topic, *_ in ways}
        for _ in range(samples):
            for topic, end, make in ways:
                due = time.perf_counter() + 0.5 / rate
                results[topic].append(once(topic, end, make(), 1.0))
                while (rest := due - time.perf_counter()) > 0.0:
                    executor.spin_once(timeout_sec=rest)
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
            process.wait()
        node.destroy_node()
    return results["joint_states"], results["relayed"]


def share(rate: float, seconds: float) -> tuple[float, float]:
    """Of a core, that one process takes for four links; of their frames, that it published."""
    links = [FakeLink(i) for i in (1, 2, 3, 4)]
    urls = ", ".join(f"'{link.url}'" for link in links)
    node, executor = Node("bench_driver"), SingleThreadedExecutor()
    for kind, topic in ((JointState, "joint_states"), *TELEMETRY):  # somebody always listens
        node.create_subscription(kind, topic, lambda _: None, sensor(), raw=True)
    believed: dict[str, int] = {}

    def hear(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            believed[status.name] = int(values.get("believed", 0))

    node.create_subscription(DiagnosticArray, "/diagnostics", hear, 100)
    executor.add_node(node)
    listening = Thread(target=executor.spin)
    listening.start()
    process = start_driver(f"urls:=[{urls}]", f"rate:={rate}")
    try:
        begun = time.monotonic() + 5.0  # by then it has started, and has adopted its links
        at, sent, used = begun - 2.0, 0, 0.0
        while at < begun + seconds:
            time.sleep(max(0.0, at - time.monotonic()))
            for link in links:
                link.send(link.measure(at))
            if at < begun:
                used = processor_time(process.pid)
            at, sent = at + 1.0 / rate, sent + 4
        used = processor_time(process.pid) - used
        time.sleep(2.0)  # for the last diagnostics
        return used / seconds, sum(believed.values()) / sent
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
        executor.shutdown()
        listening.join()
        node.destroy_node()


def processor_time(pid: int) -> float:
    """Of a process, user and system [s]."""
    with open(f"/proc/{pid}/stat") as file:
        values = file.read().rpartition(")")[2].split()
    return (int(values[11]) + int(values[12])) / os.sysconf("SC_CLK_TCK")


def relay(peer: int, port: int) -> None:
    """Run the relay."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(RelayNode(peer, port))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=2000)
    parser.add_argument("--rate", type=float, default=50.0, help="datagrams to each a second")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each processor share")
    given = parser.parse_args()
    os.chdir(os.path.dirname(os.path.abspath(__file__)))
    rclpy.init()
    driver, bare = latencies(given.samples, given.rate)
    good = True
    for name, quantile in (("p50", 50), ("p99", 99)):
        ours, peer = (
            1e6 * statistics.quantiles(times, n=100)[quantile - 1] for times in (driver, bare)
        )
        good &= ours <= LIMIT * peer
        print(f"{name}: driver {ours:7.0f} us, bare relay {peer:7.0f} us, ratio {ours / peer:.2f}")
    for rate in RATES:
        core, published = share(rate, given.seconds)
        print(
            f"four links at {rate:g} Hz: {100.0 * core:.1f}% of a core, "
            f"{100.0 * published:.1f}% of the frames published"
        )
    rclpy.try_shutdown()
    return 0 if good else 2


if __name__ == "__main__":
    sys.exit(main())
