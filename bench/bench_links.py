"""Supported load of the links' drivers: frames a second per core, and none of them lost.

    . scripts/env.sh; python bench/bench_links.py --links 12 --rates 50 100 200 400

A process sends the telemetry of all links in turn, with real-time priority where the system allows
it, and measures how late it is itself. The drivers are the real nodes, in one process or, with
--each, in one per link; a subscriber receives all joint states. A rate is supported if every frame
was processed, no telemetry was shed and no link was lost. A row whose sender was late by more than
a period says less than it seems to. On a busy computer the result is a lower bound.

Exits with 2 if the first rate is not supported, or if a link was lost at any rate.
"""

import argparse
import multiprocessing
import os
import select
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import rclpy
from bench_driver import FakeLink, processor_time, start_driver
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_ros.qos import sensor

ADOPTION_TIMEOUT = 60.0  # for the drivers' start [s]
DIAGNOSTICS_PERIOD = 1.0  # [s]
PRIORITY = 1  # of the sender among real-time processes
COUNTS = "accepted", "missed", "dropped", "telemetry_shed", "lost"


class Sent(NamedTuple):
    """What the sender did in a step."""

    frames: int
    late: float  # 99th percentile of its lateness [s]
    latest: float  # largest [s]


def send_frames(pipe: Connection, count: int) -> None:
    """Send telemetry of `count` links at the rates that arrive in the pipe, until one is 0."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    links = [FakeLink(i) for i in range(1, count + 1)]
    pipe.send([link.url for link in links])
    sockets = {link.socket: link for link in links}
    rate: float = pipe.recv()
    lateness: list[float] = []
    due, k = time.monotonic(), 0
    while rate:
        for ready in select.select(list(sockets), [], [], max(0.0, due - time.monotonic()))[0]:
            sockets[ready].answer(ready.recv(100))
        if (now := time.monotonic()) >= due:
            lateness.append(now - due)
            links[k % count].report()
            k, due = k + 1, due + 1.0 / (count * rate)  # a late one catches up
        if pipe.poll():
            rate = pipe.recv()
            pipe.send(Sent(len(lateness), float(np.quantile(lateness, 0.99)), max(lateness)))
            lateness, due = [], time.monotonic()


class Watch(Node):
    """Receives joint states, and the drivers' counts."""

    def __init__(self) -> None:
        super().__init__("bench_links")
        self.counts: dict[str, dict[str, int]] = {}
        self.received = 0
        self.create_subscription(JointState, "joint_states", self.on_state, sensor(), raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 100)

    def on_state(self, _: bytes) -> None:
        """Count joint states."""
        self.received += 1

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Store the counts of a driver."""
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "accepted" in values:
                self.counts[status.name] = {name: int(values[name]) for name in COUNTS}

    def spin(self, seconds: float) -> None:
        """Receive for a time [s]."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.1)

    def totals(self) -> dict[str, int]:
        """Return the sums over all drivers."""
        return {name: sum(c[name] for c in self.counts.values()) for name in COUNTS}


def run(folder: Path, options: argparse.Namespace) -> int:
    """Print a row for each rate; return the exit code."""
    count = options.links
    ours, theirs = multiprocessing.Pipe()
    sender = multiprocessing.Process(target=send_frames, args=(theirs, count))
    sender.start()
    urls = ours.recv()
    paper, arm = paper_arm(), f"arm:={folder}/arm.yaml"
    save(replace(paper, links=(paper.links * count)[:count]), folder / "arm.yaml")
    rclpy.init()
    watch, good = Watch(), []
    drivers = (
        [start_driver(arm, f"link:={i}", f"url:={url}") for i, url in enumerate(urls, 1)]
        if options.each
        else [start_driver(arm, f"urls:=[{', '.join(repr(url) for url in urls)}]")]
    )
    try:
        ours.send(options.rates[0])
        deadline = time.monotonic() + ADOPTION_TIMEOUT
        while len(watch.counts) < count or watch.totals()["accepted"] < 10 * count:
            if time.monotonic() > deadline:
                raise TimeoutError(f"{len(watch.counts)} of {count} links were adopted")
            watch.spin(0.5)
        print("| links | rate [Hz] | frames/s | sender late, p99 and largest [ms] | missed | shed "
              "| links lost | cores | processed per s and core |")  # fmt: skip
        print("|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
        for rate in options.rates:
            ours.send(rate)
            ours.recv()
            watch.spin(2.0 * DIAGNOSTICS_PERIOD)  # the change of rate
            before, start = watch.totals(), time.monotonic()
            used = -sum(processor_time(driver.pid) for driver in drivers)
            watch.spin(options.seconds)
            used += sum(processor_time(driver.pid) for driver in drivers)
            cores = used / (time.monotonic() - start)
            ours.send(rate)
            sent: Sent = ours.recv()
            watch.spin(1.5 * DIAGNOSTICS_PERIOD)
            change = {name: now - before[name] for name, now in watch.totals().items()}
            processed = change["accepted"] / options.seconds
            lost = change["missed"] + change["dropped"] + change["telemetry_shed"]
            good.append((change["lost"] == 0, lost == 0))
            print(
                f"| {count} | {rate:g} | {count * rate:g} | {1e3 * sent.late:.1f}, "
                f"{1e3 * sent.latest:.1f} | {change['missed']} | {change['telemetry_shed']} "
                f"| {change['lost']} | {cores:.2f} | {processed / cores:.0f} |",
                flush=True,
            )
    finally:
        ours.send(0.0)
        for driver in drivers:
            driver.send_signal(signal.SIGTERM)
        for driver in drivers:
            driver.wait()
        sender.join()
        watch.destroy_node()
        rclpy.try_shutdown()
    return 0 if good[0][1] and all(kept for kept, _ in good) else 2


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--links", type=int, default=12)
    parser.add_argument("--rates", type=float, nargs="+", default=[50.0, 100.0, 200.0, 400.0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each rate")
    parser.add_argument("--each", action="store_true", help="use a process for each link")
    options = parser.parse_args()
    os.chdir(Path(__file__).parent)
    with TemporaryDirectory() as folder:
        return run(Path(folder), options)


if __name__ == "__main__":
    sys.exit(main())
