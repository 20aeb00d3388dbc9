"""Effect of the view on the latency of the drivers at 10 times real time.

The test bed, one driver for four links and base_reaction run throughout. All datagrams of the links
pass through a relay in this process, which records when it forwards each telemetry frame to the
driver. The latency is the time until the driver's message of that frame. Each round has one block
of each kind, in random order:

    without   no view; `again` is the same, to show how much two equal blocks differ
    attached  the view serves its page
    detached  the rerun program that it feeds was killed, the view continues
    flooded   also 2,000 messages of base_reaction per second
    killed    the view was killed just before

Each kind is compared with `without` in the same round. A difference is measurable if its mean is
significant (paired t-test; 5 % for all comparisons together).
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
SIGNIFICANCE = 0.05 / (
    len(PERCENTS) * (len(KINDS) - 2)
)  # of one comparison; `again` is not compared
MODULES |= {"view": "fss_arm_view.view_node", "base_reaction": "fss_arm_view.base_reaction_node"}


class Relay:
    """Forwards the datagrams of all links, and records when each frame was sent to the driver."""

    def __init__(self, testbed: list[int], drivers: list[int]) -> None:
        self.driver_side = [_socket() for _ in testbed]  # ports that the driver sends to
        self.link_side = [_socket() for _ in testbed]
        self.testbed, self.drivers = testbed, drivers
        self.sent_at: dict[tuple[int, int], float] = {}
        self.done = Event()
        self.thread = Thread(target=self.run, daemon=True)

    def urls(self) -> str:
        """Return the URLs for the driver."""
        ports = [s.getsockname()[1] for s in self.driver_side]
        return str([f"udp://127.0.0.1:{p}?bind={d}" for p, d in zip(ports, self.drivers,
                                                                    strict=True)])  # fmt: skip

    def run(self) -> None:
        """Forward datagrams until `done` is set."""
        while not self.done.is_set():
            for ready in select.select([*self.driver_side, *self.link_side], [], [], 0.2)[0]:
                data = ready.recv(2048)
                if ready in self.driver_side:
                    k = self.driver_side.index(ready)
                    self.link_side[k].sendto(data, ("127.0.0.1", self.testbed[k]))
                    continue
                k, frame = self.link_side.index(ready), decode(data)
                if isinstance(frame, Telemetry):
                    self.sent_at[frame.link, frame.sequence] = time.perf_counter()
                self.driver_side[k].sendto(data, ("127.0.0.1", self.drivers[k]))


class ViewGraph(Graph):
    """Test bed, driver and base_reaction, and a view that is started and killed."""

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
        """Start the view, and wait until it serves its page."""
        port, web = self.domain.ports(2)  # of TCP
        self.start("view", port=port, web_port=web, use_sim_time=True)
        log = self.folder / "view.log"
        while "open http" not in log.read_text():
            if self.processes["view"].poll() is not None:
                raise RuntimeError(log.read_text())
            time.sleep(0.1)
        time.sleep(2.0)

    def viewers(self) -> list[int]:
        """Return the process ids of the rerun programs that the view has started."""
        pid = self.processes["view"].pid
        return list(map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()))

    def kill_view(self) -> None:
        """Kill the view and its children."""
        if "view" in self.processes:
            children = self.viewers() if self.processes["view"].poll() is None else []
            self.processes["view"].kill()
            self.processes.pop("view").wait()
            for pid in children:
                with suppress(ProcessLookupError):  # it exits with its parent
                    os.kill(pid, signal.SIGKILL)


def _socket() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", 0))
    return s


class LatencyListener(Node):
    """Subscribes to the telemetry of the driver."""

    def __init__(self, relay: Relay) -> None:
        super().__init__("bench_view")
        self.relay = relay
        self.latencies: list[float] = []
        for topic in TELEMETRY:
            self.create_subscription(LinkTelemetry, topic, self.on_telemetry, sensor())

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """Record the latency of a frame."""
        now = time.perf_counter()
        sent_at = self.relay.sent_at.pop((message.link, message.sequence), None)
        if sent_at is not None:
            self.latencies.append(now - sent_at)


def flood(folder: Path, done: Event) -> None:
    """Publish base_reaction, which only the view subscribes to, in a separate process."""
    code = (  # with idle priority, like the view, as its own load is not measured
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
    done.wait()
    process.kill()
    process.wait()


def block(kind: str, graph: ViewGraph, listener: LatencyListener, seconds: float) -> list[float]:
    """Run one block; return the latencies [s]."""
    done, flooder = Event(), None
    if kind not in ("without", "again"):
        graph.view()
    if kind == "detached":
        for pid in graph.viewers():
            os.kill(pid, signal.SIGKILL)
    if kind == "flooded":
        flooder = Thread(target=flood, args=(graph.folder, done))
        flooder.start()
        time.sleep(2.0)
    if kind == "killed":
        graph.kill_view()
    listener.latencies = []
    time.sleep(seconds)
    found, listener.latencies = listener.latencies, []
    done.set()
    if flooder:
        flooder.join()
    graph.kill_view()
    time.sleep(1.0)
    return found


def quantile(percent: int) -> Callable[[list[float]], float]:
    """Return a function that gives this percentile of latencies [s] in us."""
    return lambda times: 1e6 * statistics.quantiles(times, n=100)[percent - 1]


def main() -> int:
    """Run the blocks in random order, and compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each block, real time")
    options = parser.parse_args()
    rclpy.init()
    blocks: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    with TemporaryDirectory(prefix="bench_view_") as name:
        graph = ViewGraph(Path(name))
        listener, executor = LatencyListener(graph.relay), SingleThreadedExecutor()
        executor.add_node(listener)
        listening = Thread(target=executor.spin, daemon=True)
        listening.start()
        try:
            deadline = time.monotonic() + 60.0
            while len(listener.latencies) < 200:
                if time.monotonic() > deadline:
                    raise RuntimeError(f"the graph does not start within 60 s, see {graph.folder}")
                time.sleep(0.2)
            random = Random(1)
            for number in range(options.rounds):
                for kind in random.sample(KINDS, len(KINDS)):
                    blocks[kind].append(block(kind, graph, listener, options.seconds))
                    p50, p99 = (quantile(percent)(blocks[kind][-1]) for percent in PERCENTS)
                    print(f"{number + 1} {kind:10} {p50:6.0f} {p99:6.0f} us", flush=True)
        finally:
            graph.kill_view()
            graph.stop()
            graph.relay.done.set()
            executor.shutdown()
            listening.join()
            rclpy.try_shutdown()
    return report(blocks, options.rounds, options.seconds)


def report(blocks: dict[str, list[list[float]]], rounds: int, seconds: float) -> int:
    """Print a row for each kind; return 2 if a difference is measurable."""
    cores = len(os.sched_getaffinity(0))
    print(f"{cores} cores, {rounds} rounds of {seconds:g} s, {SPEED:g} times real time")
    print(
        f"{'':10} {'frames/s':>8} {'p50 us':>8} {'p99 us':>8}   difference to without, p50 and p99"
    )
    measurable = False
    for kind, found in blocks.items():
        frames = statistics.mean(len(times) for times in found) / seconds
        row, texts = [], []
        for percent in PERCENTS:
            value = quantile(percent)
            ours, baseline = list(map(value, found)), list(map(value, blocks["without"]))
            row.append(statistics.median(ours))
            if kind != "without":
                differences = [a - b for a, b in zip(ours, baseline, strict=True)]
                p = float(ttest_1samp(differences, 0.0).pvalue)
                measurable |= kind != "again" and p < SIGNIFICANCE
                spread = statistics.stdev(differences) / len(differences) ** 0.5
                verdict = "MEASURABLE" if p < SIGNIFICANCE else "not measurable"
                texts.append(f"{statistics.mean(differences):+6.0f} ± {spread:4.0f} us {verdict}")
        print(f"{kind:10} {frames:8.0f} {row[0]:8.0f} {row[1]:8.0f}   {'; '.join(texts)}")
    return 2 if measurable else 0


if __name__ == "__main__":
    sys.exit(main())
