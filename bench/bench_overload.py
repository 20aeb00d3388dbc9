"""Overload by telemetry: share of published frames, and latency of commands and stops.

Links send telemetry at increasing rates to their drivers, in one process or one each; a node
subscribes to all their topics. Meanwhile the links are armed and stopped repeatedly. Reported: the
longest gap between commands at a link, and the time from publishing a stop to its frame at each
link.
"""

import argparse
import multiprocessing
import os
import select
import signal
import sys
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import NamedTuple

import numpy as np
import rclpy
from bench_driver import FakeLink, processor_time, start_driver
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from std_srvs.srv import SetBool

from fss_arm_driver.protocol import Command, LinkCommandFlag, decode
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import sensor

MAX_STOP_LATENCY = 0.25  # from a stop to each link [s]
ARMING_TIMEOUT = 60.0  # for starting and arming [s]


class Arrival(NamedTuple):
    """A command at a link."""

    at: float  # [s]
    link: int
    flags: int


class Report(NamedTuple):
    """Sent frames and received commands of the links."""

    sent: list[int]  # frames of each
    max_delay: float  # largest delay of the links' own frames [s]
    arrivals: list[Arrival]


def run_links(pipe: Connection, count: int, rate: float) -> None:
    """Run `count` links until a message in the pipe; in a separate process, not measured."""
    links = [FakeLink(i) for i in range(1, count + 1)]
    pipe.send([link.url for link in links])
    sockets = {link.socket: link for link in links}
    arrivals: list[Arrival] = []
    sent, latest, due = [0] * count, 0.0, time.monotonic()
    while not pipe.poll():
        wait = max(0.0, due - time.monotonic())
        for ready in select.select(list(sockets), [], [], wait)[0]:
            link = sockets[ready]
            data = link.socket.recv(100)
            command = decode(data)
            if isinstance(command, Command):
                link.answer(data)
                arrivals.append(Arrival(time.monotonic(), link.frame.link, command.flags))
        if (now := time.monotonic()) >= due:
            latest = max(latest, now - due)
            for k, link in enumerate(links):
                link.report()
                sent[k] += 1
            due = max(due + 1.0 / rate, now - 1.0)
    pipe.recv()
    pipe.send(Report(sent, latest, arrivals))


class Watch(Node):
    """Subscribes to all topics of the drivers, arms and stops their links."""

    def __init__(self, count: int) -> None:
        super().__init__("bench_overload")
        self.counts: dict[str, dict[str, int]] = {}  # of each link, by its diagnostics
        self.published = [0] * count
        self.create_subscription(JointState, "joint_states", lambda _: None, sensor(), raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 100)
        for k in range(count):
            self.create_subscription(
                LinkTelemetry,
                f"link_{k + 1}/telemetry",
                lambda _, k=k: self.count(k),
                sensor(),
                raw=True,
            )
        self.stop = self.create_publisher(Empty, "arm/stop", 10)
        self.arms = [self.create_client(SetBool, f"link_{k + 1}/arm") for k in range(count)]
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        self.executor_thread = Thread(target=executor.spin)
        self.spinner = executor
        self.executor_thread.start()

    def close(self) -> None:
        """Stop the executor."""
        self.spinner.shutdown()
        self.executor_thread.join()
        self.destroy_node()

    def count(self, k: int) -> None:
        """Count a link's telemetry."""
        self.published[k] += 1

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Store the counters of the drivers."""
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "accepted" in values:
                counts = {name: int(n) for name, n in values.items() if n.isdigit()}
                self.counts[status.name] = counts

    def arm(self) -> None:
        """Arm all links, with as many requests as needed.

        Raises:
            RuntimeError: they cannot be armed.
        """
        deadline, left = time.monotonic() + ARMING_TIMEOUT, dict(enumerate(self.arms))
        answers = {}
        while left:
            if time.monotonic() > deadline:
                raise RuntimeError(f"links {[k + 1 for k in left]} cannot be armed")
            for k, client in list(left.items()):
                answer = answers.get(k)
                if answer and answer.done() and answer.result().success:
                    del left[k]
                elif client.service_is_ready() and (answer is None or answer.done()):
                    answers[k] = client.call_async(SetBool.Request(data=True))
            time.sleep(0.02)


def run(folder: str, count: int, rate: float, seconds: float, together: bool) -> bool:
    """Print a row; return True if all stops arrived in time and no link was lost."""
    ours, theirs = multiprocessing.Pipe()
    links_process = multiprocessing.Process(target=run_links, args=(theirs, count, rate))
    links_process.start()
    urls = ours.recv()
    paper, arm = paper_arm(), f"arm:={folder}/arm.yaml"
    save(replace(paper, links=(paper.links * count)[:count]), Path(folder, "arm.yaml"))
    drivers = (
        [start_driver(arm, f"urls:=[{', '.join(repr(url) for url in urls)}]")]
        if together
        else [start_driver(arm, f"link:={i}", f"url:={url}") for i, url in enumerate(urls, 1)]
    )
    watch = Watch(count)
    stops, armed = [], 0
    try:
        watch.arm()
        start, before = time.monotonic(), list(watch.published)
        used = -sum(processor_time(driver.pid) for driver in drivers)
        while time.monotonic() < start + seconds:
            try:
                watch.arm()
                armed += 1
            except RuntimeError:
                pass
            time.sleep(1.0)
            stops.append(time.monotonic())
            watch.stop.publish(Empty())
            time.sleep(1.5)
        end = time.monotonic()
        used += sum(processor_time(driver.pid) for driver in drivers)
        published = sum(watch.published) - sum(before)
        time.sleep(2.0)  # for the last diagnostics
    finally:
        shutdown_time = time.monotonic()
        for driver in drivers:
            driver.send_signal(signal.SIGTERM)
        for driver in drivers:
            driver.wait()
        shutdown_time = time.monotonic() - shutdown_time
        ours.send(None)
        report: Report = ours.recv()
        links_process.join()
        watch.close()
    latencies = [
        min(
            (
                a.at
                for a in report.arrivals
                if a.link == k and a.at > at and a.flags & LinkCommandFlag.STOP
            ),
            default=np.inf,
        )
        - at
        for at in stops
        for k in range(1, count + 1)
    ]
    gaps = [
        np.diff([a.at for a in report.arrivals if a.link == k and start < a.at < end])
        for k in range(1, count + 1)
    ]
    gap = max((g.max(initial=0.0) for g in gaps), default=0.0)
    total = {
        name: sum(c.get(name, 0) for c in watch.counts.values())
        for name in ("accepted", "lost", "dropped")
    }
    sent = count * rate * (end - start)
    print(
        f"{count} links at {rate:g} Hz, {'one process' if together else 'one each'}: "
        f"{100.0 * published / sent:.0f}% published, {total['dropped']} dropped, "
        f"{total['lost']} lost, {100.0 * used / (end - start):.0f}% of a core; "
        f"longest gap of commands {gap:.2f} s; stop p50 {np.quantile(latencies, 0.5):.3f}, "
        f"p99 {np.quantile(latencies, 0.99):.3f}, worst {max(latencies):.3f} s of {len(stops)}; "
        f"SIGTERM {shutdown_time:.1f} s; links delayed {report.max_delay:.2f} s",
        flush=True,
    )
    return max(latencies) <= MAX_STOP_LATENCY and total["lost"] == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--links", type=int, default=12)
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0, 100.0, 500.0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--each", action="store_true", help="use a process for each link")
    options = parser.parse_args()
    os.chdir(os.path.dirname(os.path.abspath(__file__)))
    rclpy.init()
    with TemporaryDirectory() as folder:
        run_options = options.seconds, not options.each
        good = [run(folder, options.links, rate, *run_options) for rate in options.rates]
    rclpy.try_shutdown()
    return 0 if all(good) else 2


if __name__ == "__main__":
    sys.exit(main())
