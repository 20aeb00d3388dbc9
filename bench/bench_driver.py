"""Latency of the driver between datagrams and topics, compared with a bare relay; core share.

The relay is an rclpy node that receives datagrams in the same way and copies one float of each into
a std_msgs/Float64. Both run at the same time in separate processes, and receive datagrams in turn.
Then arm/joint_commands is streamed: the nodes of arm and links share one process, with and without
the guard, or use two. The relay of commands copies each position of a JointState into a datagram.
Finally one process drives four links at several rates.
"""

import argparse
import os
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from threading import Thread

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from fss_arm_driver.protocol import (
    Command,
    LinkCommandFlag,
    Mode,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
)
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR, sensor
from fss_link.receiver import Receiver
from fss_link.transport import UdpTransport

MAX_RATIO = 1.3  # of the driver's latency to that of the relay
RATES = (5.0, 100.0, 500.0)
STREAMS = (50.0, 200.0)
JOINTS = ("joint_1", "joint_2", "joint_3", "joint_4")
SO_TIMESTAMPNS = 35  # of Linux; Python has no name for it
POSITION_STEP = 2.618e-5  # of the streamed positions, so that each gives different counts [rad]
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

    def poll(self, datagrams: list[bytes], _: bool) -> None:
        """Publish one float of each datagram."""
        for data in datagrams:
            self.publisher.publish(Float64(data=struct.unpack("<d", data[:8])[0]))


class CommandRelayNode(Node):
    """Copies the positions of a JointState to a datagram each."""

    def __init__(self, peers: list[int], ports: list[int]) -> None:
        super().__init__("command_relay")
        ends = zip(peers, ports, strict=True)
        self.transports = [UdpTransport("127.0.0.1", peer, port) for peer, port in ends]
        self.create_subscription(JointState, "relay/joint_commands", self.on_command, 1)

    def on_command(self, message: JointState) -> None:
        """Send each position in a datagram."""
        for transport, position in zip(self.transports, message.position, strict=True):
            transport.send(struct.pack("<9d", *9 * [position]))


class Peer:
    """Remote end of a UDP transport."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.socket.bind(("127.0.0.1", 0))
        self.port: int = self.socket.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.driver_port: int = free.getsockname()[1]

    @property
    def url(self) -> str:
        """URL for the driver."""
        return f"udp://127.0.0.1:{self.port}?bind={self.driver_port}"

    def receive(self) -> tuple[bytes, float]:
        """Return a datagram, and the time of day at which the kernel received it [s]."""
        data, ((_, _, stamp),), *_ = self.socket.recvmsg(100, 100)
        seconds, nanoseconds = struct.unpack("qq", stamp)
        return data, seconds + 1e-9 * nanoseconds

    def send(self, data: bytes) -> None:
        """Send a datagram to the driver."""
        self.socket.sendto(data, ("127.0.0.1", self.driver_port))


class FakeLink(Peer):
    """Link that sends telemetry on request."""

    def __init__(self, number: int = 1) -> None:
        super().__init__()
        self.frame, self.arrival = replace(FRAME, link=number), 0.0

    def answer(self, data: bytes) -> int:
        """Receive a command; return its set point [counts]."""
        command = decode(data)
        assert isinstance(command, Command)
        state = {int(LinkCommandFlag.ARM): State.ARMED, int(LinkCommandFlag.STOP): State.STOPPED}
        flag = state.get(command.flags & (LinkCommandFlag.ARM | LinkCommandFlag.STOP), 0)
        self.frame = replace(self.frame, echo=command.clock & 0xFFFFFFFF, flags=FRAME.flags | flag)
        self.arrival = time.monotonic()
        return command.set_point

    def report(self) -> None:
        """Send a telemetry frame."""
        turnaround = round(1e6 * (time.monotonic() - self.arrival)) if self.frame.echo else 0
        self.frame = replace(self.frame, turnaround=turnaround)
        self.send(self.measure())

    def measure(self, at: float | None = None) -> bytes:
        """Return a telemetry frame measured at a time [s], by default now."""
        clock = round(1e6 * (time.monotonic() if at is None else at))
        self.frame = replace(self.frame, sequence=self.frame.sequence + 1, clock=clock)
        return encode(self.frame)


def start(*code_and_arguments: str) -> subprocess.Popen[bytes]:
    """Start a Python process."""
    return subprocess.Popen([sys.executable, "-c", *code_and_arguments])


def start_driver(*parameters: str, kind: str = "link") -> subprocess.Popen[bytes]:
    code = f"import sys; from fss_arm_driver.{kind}_node import main; sys.exit(main())"
    options = [word for parameter in parameters for word in ("-p", parameter)]
    return start(code, "--ros-args", *options)


def latencies(samples: int, rate: float) -> tuple[list[float], list[float]]:
    """Return the latencies of driver and relay [s], measured `samples` times in turn."""
    link, peer = FakeLink(), Peer()
    code = f"from bench_driver import relay; relay({peer.port}, {peer.driver_port})"
    processes = [start_driver(f"url:={link.url}"), start(code)]
    node = Node("bench_driver")
    arrivals: dict[str, float] = {}
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for kind, topic in ((JointState, "joint_states"), (Float64, "relayed")):
        node.create_subscription(
            kind,
            topic,
            lambda _, topic=topic: arrivals.setdefault(topic, time.perf_counter()),
            sensor(),
            raw=True,
        )

    def measure_once(topic: str, end: Peer, data: bytes, timeout: float) -> float:
        arrivals.pop(topic, None)
        start_time = time.perf_counter()
        end.send(data)
        while topic not in arrivals and time.perf_counter() - start_time < timeout:
            executor.spin_once(timeout_sec=0.01)
        return arrivals.get(topic, float("inf")) - start_time

    paths: tuple[tuple[str, Peer, Callable[[], bytes]], ...] = (
        ("joint_states", link, link.measure),
        ("relayed", peer, lambda: struct.pack("<9d", *9 * [1.0])),
    )
    try:
        for topic, end, make in paths:
            deadline = time.monotonic() + 20.0
            while measure_once(topic, end, make(), 0.1) == float("inf"):
                if time.monotonic() > deadline:
                    raise RuntimeError(f"no message on {topic} within 20 s")
        results: dict[str, list[float]] = {topic: [] for topic, *_ in paths}
        for _ in range(samples):
            for topic, end, make in paths:
                due = time.perf_counter() + 0.5 / rate
                results[topic].append(measure_once(topic, end, make(), 1.0))
                while (remaining := due - time.perf_counter()) > 0.0:
                    executor.spin_once(timeout_sec=remaining)
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
            process.wait()
        node.destroy_node()
    return results["joint_states"], results["relayed"]


class Bench:
    """Four links, their drivers, the node `arm` and the relay, for streamed commands."""

    def __init__(self, rate: float, together: bool, guard: bool) -> None:
        self.links, self.peers = [FakeLink(i) for i in (1, 2, 3, 4)], [Peer() for _ in JOINTS]
        urls = ", ".join(f"'{link.url}'" for link in self.links)
        far, driver_port = [p.port for p in self.peers], [p.driver_port for p in self.peers]
        code = f"from bench_driver import relay_commands; relay_commands({far}, {driver_port})"
        links = [f"urls:=[{urls}]", f"max_rate:={2.0 * rate}", "timeout:=3.0"]
        arm = ["time_to_live:=3.0", f"guard:={str(guard).lower()}"]
        parameters = {"driver": [*links, *arm]} if together else {"link": links, "arm": arm}
        self.processes = [
            *(start_driver(*options, kind=kind) for kind, options in parameters.items()),
            start(code),
        ]
        self.node = Node("bench_driver")
        self.publishers = {
            name: self.node.create_publisher(JointState, f"{name}/joint_commands", 1)
            for name in ("arm", "relay")
        }
        self.counts, self.reported = 0, 0.0

    def arm(self) -> None:
        """Wait until all links are armed."""
        client = self.node.create_client(SetBool, "arm/enable")
        deadline, answer = time.monotonic() + 60.0, None
        while not (answer and answer.done() and answer.result().success):
            if time.monotonic() > deadline:
                raise RuntimeError(f"links not armed within 60 s: {answer and answer.result()}")
            if client.service_is_ready() and (answer is None or answer.done()):
                answer = client.call_async(SetBool.Request(data=True))
            self.wait(0.005)
            rclpy.spin_once(self.node, timeout_sec=0.0)

    def wait(self, seconds: float, expected: Sequence[Peer] = ()) -> list[float]:
        """Let links answer for `seconds` or until all expected datagrams arrived; return times."""
        end, arrivals, remaining = time.perf_counter() + seconds, [], list(expected)
        while (left := end - time.perf_counter()) > 0.0 and (remaining or not expected):
            if time.monotonic() > self.reported + 0.2:
                self.reported = time.monotonic()
                for link in self.links:
                    link.report()
            sockets = {peer.socket: peer for peer in (*self.links, *self.peers)}
            for ready in select.select(list(sockets), [], [], min(left, 0.05))[0]:
                peer = sockets[ready]
                data, at = peer.receive()
                value = peer.answer(data) if isinstance(peer, FakeLink) else self.counts
                if peer in remaining and value == self.counts:
                    remaining.remove(peer)
                    arrivals.append(at)
        return arrivals

    def measure_once(self, name: str) -> list[float]:
        """Return the latencies of a command's datagrams [s]; infinite for lost ones."""
        self.counts = self.counts % 1000 + 1
        message = JointState(name=JOINTS, position=4 * [self.counts * POSITION_STEP])
        message.header.stamp = self.node.get_clock().now().to_msg()
        start_time = time.time()
        self.publishers[name].publish(message)
        arrivals = self.wait(0.5, self.links if name == "arm" else self.peers)
        return [at - start_time for at in arrivals] + (4 - len(arrivals)) * [float("inf")]

    def close(self) -> None:
        """Stop all processes."""
        for process in self.processes:
            process.send_signal(signal.SIGINT)
            process.wait()
        self.node.destroy_node()


def stream_latencies(
    rate: float, samples: int, together: bool, guard: bool = False
) -> tuple[list[float], list[float]]:
    """Return the latencies of the arm's stream and of the relay [s], in turn at `rate`."""
    bench = Bench(rate, together, guard)
    found: dict[str, list[float]] = {"arm": [], "relay": []}
    try:
        bench.arm()
        for count in range(-20, samples):
            for name, latencies in found.items():
                due = time.perf_counter() + 0.5 / rate
                arrivals = bench.measure_once(name)
                if count >= 0:
                    latencies += arrivals
                bench.wait(due - time.perf_counter())
    finally:
        bench.close()
    return found["arm"], found["relay"]


def processor_share(rate: float, seconds: float) -> tuple[float, float]:
    """Return the core share of one process for four links, and the share of published frames."""
    links = [FakeLink(i) for i in (1, 2, 3, 4)]
    urls = ", ".join(f"'{link.url}'" for link in links)
    node, executor = Node("bench_driver"), SingleThreadedExecutor()
    for kind, topic in ((JointState, "joint_states"), *TELEMETRY):  # as subscribers always exist
        node.create_subscription(kind, topic, lambda _: None, sensor(), raw=True)
    accepted: dict[str, int] = {}

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            accepted[status.name] = int(values.get("accepted", 0))

    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 100)
    executor.add_node(node)
    listening = Thread(target=executor.spin)
    listening.start()
    process = start_driver(f"urls:=[{urls}]", f"rate:={rate}")
    try:
        start_time = time.monotonic() + 5.0  # until then it starts and adopts its links
        at, sent, used = start_time - 2.0, 0, 0.0
        while at < start_time + seconds:
            time.sleep(max(0.0, at - time.monotonic()))
            for link in links:
                link.send(link.measure(at))
            if at < start_time:
                used = processor_time(process.pid)
            at, sent = at + 1.0 / rate, sent + 4
        used = processor_time(process.pid) - used
        time.sleep(2.0)  # for the last diagnostics
        return used / seconds, sum(accepted.values()) / sent
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
        executor.shutdown()
        listening.join()
        node.destroy_node()


def processor_time(pid: int) -> float:
    """Return user plus system time of a process [s]."""
    with open(f"/proc/{pid}/stat") as file:
        values = file.read().rpartition(")")[2].split()
    return (int(values[11]) + int(values[12])) / os.sysconf("SC_CLK_TCK")


def relay(peer: int, port: int) -> None:
    """Run the relay."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(RelayNode(peer, port))


def relay_commands(peers: list[int], ports: list[int]) -> None:
    """Run the relay of commands."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(CommandRelayNode(peers, ports))


def compare(what: str, driver: list[float], bare: list[float]) -> bool:
    """Print both latencies; return True if the driver is within the limit."""
    good = True
    for name, quantile in (("p50", 50), ("p99", 99)):
        ours, peer = (
            1e6 * statistics.quantiles(times, n=100)[quantile - 1] for times in (driver, bare)
        )
        good &= ours <= MAX_RATIO * peer
        print(
            f"{what}, {name}: driver {ours:7.0f} us, bare relay {peer:7.0f} us, "
            f"ratio {ours / peer:.2f}"
        )
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=2000)
    parser.add_argument("--rate", type=float, default=50.0, help="datagrams per second to each")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each core share [s]")
    options = parser.parse_args()
    os.chdir(os.path.dirname(os.path.abspath(__file__)))
    rclpy.init()
    good = compare("datagram to topic", *latencies(options.samples, options.rate))
    for together, guard in ((True, False), (True, True), (False, False)):
        how = ("one process" if together else "two processes") + (", guarded" if guard else "")
        for rate in STREAMS:
            found = stream_latencies(rate, options.samples // 4, together, guard)
            within = compare(f"{how}: stream at {rate:g} Hz to datagram", *found)
            good &= within or not together or guard
    for rate in RATES:
        core, published = processor_share(rate, options.seconds)
        print(
            f"four links at {rate:g} Hz: {100.0 * core:.1f}% of a core, "
            f"{100.0 * published:.1f}% of the frames published"
        )
    rclpy.try_shutdown()
    return 0 if good else 2


if __name__ == "__main__":
    sys.exit(main())
