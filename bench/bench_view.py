"""What the view does to the drivers: their latency at 10 times real time, without it and with it.

The test bed, one driver for four links and base_reaction run throughout. All datagrams of the links
pass a relay in this process, which notes when each telemetry frame goes on to the driver; the
latency is from there to the driver's message about that frame. In each round a block of each kind
comes, in an order drawn anew:

    without   no view, and once more, for how much two equal blocks differ
    attached  the view serves its page
    detached  the rerun program that it feeds was killed, the view goes on
    flooded   base_reaction comes at 2,000 messages a second, too
    killed    the view was killed without warning the moment before

Each kind is compared with `without` round by round: a difference counts as measurable if its mean
is farther from 0 than chance explains (t-test of paired blocks; 5 % for all comparisons together).
"""

import argparse
import os
import select
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from threading import Event, Thread

import rclpy
from bench_graph import LINKS, MODULES, TELEMETRY, Graph
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from scipy.stats import ttest_1samp

from fss_arm_driver.protocol import Telemetry, decode
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import sensor

SPEED = 10.0
FLOOD = 2000.0  # [1/s]
PERCENTS = (50, 99)
KINDS = ("without", "attached", "detached", "flooded", "killed", "again")
CHANCE = 0.05 / (len(PERCENTS) * (len(KINDS) - 2))  # of one comparison; `again` is none
MODULES |= {"view": "fss_arm_view.view_node", "base_reaction": "fss_arm_view.base_reaction_node"}


class Relay:
    """Passes the datagrams of all links on, and notes when each frame left for the driver."""

    def __init__(self, testbed: list[int], drivers: list[int]) -> None:
        self.near = [_socket() for _ in testbed]  # as the driver knows the links
        self.far = [_socket() for _ in testbed]
        self.testbed, self.drivers = testbed, drivers
        self.left: dict[tuple[int, int], float] = {}
        self.over = Event()
        self.thread = Thread(target=self.run, daemon=True)

    def urls(self) -> str:
        """For the driver."""
        ports = [s.getsockname()[1] for s in self.near]
        return str([f"udp://127.0.0.1:{p}?bind={d}" for p, d in zip(ports, self.drivers,
                                                                    strict=True)])  # fmt: skip

    def run(self) -> None:
        """Until it is over."""
        while not self.over.is_set():
            for ready in select.select([*self.near, *self.far], [], [], 0.2)[0]:
                data = ready.recv(2048)
                if ready in self.near:
                    k = self.near.index(ready)
                    self.far[k].sendto(data, ("127.0.0.1", self.testbed[k]))
                    continue
                k, frame = self.far.index(ready), decode(data)
                if isinstance(frame, Telemetry):
                    self.left[frame.link, frame.sequence] = time.perf_counter()
                self.near[k].sendto(data, ("127.0.0.1", self.drivers[k]))


class ViewGraph(Graph):
    """Test bed, driver and base_reaction, and a view that comes and goes."""

    def __init__(self, folder: Path) -> None:
        self.enter(folder)
        ports = self.domain.ports(2 * LINKS)
        self.relay = Relay(ports[:LINKS], ports[LINKS:])
        clock = {"use_sim_time": True}
        self.start("base_reaction", **clock)
        self.start("link", urls=self.relay.urls(), timeout=SPEED, watchdog=2 * SPEED, **clock)
        self.start("testbed", keep_clock=True, speed=SPEED, ports=f"{ports[:LINKS]}")
        self.relay.thread.start()

    def view(self) -> None:
        """Start it, and wait until it serves."""
        port, web = self.domain.ports(2)  # of TCP
        self.start("view", port=port, web_port=web, use_sim_time=True)
        log = self.folder / "view.log"
        while "open http" not in log.read_text():
            if self.processes["view"].poll() is not None:
                raise RuntimeError(log.read_text())
            time.sleep(0.1)
        time.sleep(2.0)

    def viewers(self) -> list[int]:
        """The rerun programs that the view has started."""
        pid = self.processes["view"].pid
        return list(map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()))

    def end_view(self) -> None:
        """Kill it and what it started."""
        if "view" in self.processes:
            children = self.viewers() if self.processes["view"].poll() is None else []
            self.processes["view"].kill()
            self.processes.pop("view").wait()
            for pid in children:
                with suppress(ProcessLookupError):  # it goes with its owner
                    os.kill(pid, signal.SIGKILL)


def _socket() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", 0))
    return s


class Ear(Node):
    """Hears the driver."""

    def __init__(self, relay: Relay) -> None:
        super().__init__("bench_view")
        self.relay = relay
        self.latencies: list[float] = []
        for topic in TELEMETRY:
            self.create_subscription(LinkTelemetry, topic, self.hear, sensor())

    def hear(self, message: LinkTelemetry) -> None:
        """The driver has passed a frame on."""
        now = time.perf_counter()
        left = self.relay.left.pop((message.link, message.sequence), None)
        if left is not None:
            self.latencies.append(now - left)


def flood(folder: Path, over: Event) -> None:
    """Publish in a process of its own what only the view listens to."""
    code = (  # as the view does, it gives way: what it costs by itself is not the question
        "import os; os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\n"
        "import time, rclpy\n"
        "from fss_arm_msgs.msg import BaseReaction\n"
        "from fss_arm_ros.qos import SENSOR\n"
        "rclpy.init(); node = rclpy.create_node('flood')\n"
        "out = node.create_publisher(BaseReaction, 'base_reaction', SENSOR)\n"
        "due = time.monotonic()\n"
        "while True:\n"
        f"    due += {1.0 / FLOOD}; message = BaseReaction()\n"
        "    message.header.stamp.sec = int(due); out.publish(message)\n"
        "    time.sleep(max(0.0, due - time.monotonic()))\n"
    )
    with (folder / "flood.log").open("wb") as log:
        process = subprocess.Popen([sys.executable, "-c", code], stdout=log, stderr=log)
    over.wait()
    process.kill()
    process.wait()


def block(kind: str, graph: ViewGraph, ear: Ear, seconds: float) -> list[float]:
    """The latencies [s] of one block."""
    over, flooder = Event(), None
    if kind not in ("without", "again"):
        graph.view()
    if kind == "detached":
        for pid in graph.viewers():
            os.kill(pid, signal.SIGKILL)
    if kind == "flooded":
        flooder = Thread(target=flood, args=(graph.folder, over))
        flooder.start()
        time.sleep(2.0)
    if kind == "killed":
        graph.end_view()
    ear.latencies = []
    time.sleep(seconds)
    found, ear.latencies = ear.latencies, []
    over.set()
    if flooder:
        flooder.join()
    graph.end_view()
    time.sleep(1.0)
    return found


def quantile(percent: int) -> Callable[[list[float]], float]:
    """Of latencies [s], in us."""
    return lambda times: 1e6 * statistics.quantiles(times, n=100)[percent - 1]


def main() -> int:
    """Alternate the blocks, and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each block, real time")
    options = parser.parse_args()
    rclpy.init()
    blocks: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    with TemporaryDirectory(prefix="bench_view_") as name:
        graph = ViewGraph(Path(name))
        ear, executor = Ear(graph.relay), SingleThreadedExecutor()
        executor.add_node(ear)
        listening = Thread(target=executor.spin, daemon=True)
        listening.start()
        try:
            deadline = time.monotonic() + 60.0
            while len(ear.latencies) < 200:
                if time.monotonic() > deadline:
                    raise RuntimeError(f"the graph does not come up, see {graph.folder}")
                time.sleep(0.2)
            random = Random(1)
            for number in range(options.rounds):
                for kind in random.sample(KINDS, len(KINDS)):
                    blocks[kind].append(block(kind, graph, ear, options.seconds))
                    p50, p99 = (quantile(percent)(blocks[kind][-1]) for percent in PERCENTS)
                    print(f"{number + 1} {kind:10} {p50:6.0f} {p99:6.0f} us", flush=True)
        finally:
            graph.end_view()
            graph.stop()
            graph.relay.over.set()
            executor.shutdown()
            listening.join()
            rclpy.try_shutdown()
    return report(blocks, options.rounds, options.seconds)


def report(blocks: dict[str, list[list[float]]], rounds: int, seconds: float) -> int:
    """Print a row for each kind; 2 if a difference is measurable."""
    cores = len(os.sched_getaffinity(0))
    print(f"{cores} cores, {rounds} rounds of {seconds:g} s, {SPEED:g} times real time")
    print(
        f"{'':10} {'frames/s':>8} {'p50 us':>8} {'p99 us':>8}   difference to without, p50 and p99"
    )
    measurable = False
    for kind, found in blocks.items():
        frames = statistics.mean(len(times) for times in found) / seconds
        row, words = [], []
        for percent in PERCENTS:
            value = quantile(percent)
            ours, theirs = list(map(value, found)), list(map(value, blocks["without"]))
            row.append(statistics.median(ours))
            if kind != "without":
                away = [a - b for a, b in zip(ours, theirs, strict=True)]
                p = float(ttest_1samp(away, 0.0).pvalue)
                measurable |= kind != "again" and p < CHANCE
                spread = statistics.stdev(away) / len(away) ** 0.5
                verdict = "MEASURABLE" if p < CHANCE else "not measurable"
                words.append(f"{statistics.mean(away):+6.0f} ± {spread:4.0f} us {verdict}")
        print(f"{kind:10} {frames:8.0f} {row[0]:8.0f} {row[1]:8.0f}   {'; '.join(words)}")
    return 2 if measurable else 0


if __name__ == "__main__":
    sys.exit(main())
