"""Jitter of `control` at 100 Hz, idle and beside a busy loop per core, without and with priority.

The inputs are those of bench_control.py, from a process with a higher priority, so that they are
regular. Period is between two steps of the node, latency from the stamp of the base's state to the
publication of the wrench, in percentiles. It exits with 1 if with priority, beside busy loops, the
latency's 99 % is above a period, or if the system permits no priority.

    . scripts/env.sh; python bench/bench_jitter.py
"""

import argparse
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import rclpy
from bench_control import RATE, World
from diagnostic_msgs.msg import DiagnosticArray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from fss_arm_ros.timing import MISSED, percentile_names

ROOT = Path(__file__).resolve().parents[1]
PRIORITY, INPUT_PRIORITY = 60, 80  # of the node, and of its inputs
KEYS = [*percentile_names("period"), *percentile_names("latency"), MISSED]
BUSY = [sys.executable, "-c", "while True: pass"]
TIMEOUT = 120.0  # until the node runs [s]


class Inputs(World):
    """Publishes the inputs of control, and keeps its diagnostics."""

    def __init__(self) -> None:
        super().__init__()
        self.values: dict[str, str] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_report, 10)

    def on_report(self, message: DiagnosticArray) -> None:
        """Store the values of `control`."""
        for status in message.status:
            if status.name == "/control":
                self.values = {value.key: value.value for value in status.values}


def measure(seconds: float, busy: bool, priority: bool) -> list[str]:
    """Return percentiles of period and latency [ms], and missed deadlines."""
    environment = {**os.environ, **({"FSS_PRIORITY": str(PRIORITY)} if priority else {})}
    command = [sys.executable, "-m", "fss_gnc.control_node", "--ros-args", "-p", f"rate:={RATE}"]
    with ExitStack() as stack:
        if busy:
            for _ in os.sched_getaffinity(0):
                loop = stack.enter_context(subprocess.Popen(BUSY))
                stack.callback(loop.kill)
        node = stack.enter_context(subprocess.Popen(command, env=environment))
        stack.callback(node.terminate)
        inputs = Inputs()
        stack.callback(inputs.destroy_node)
        give_up = time.monotonic() + TIMEOUT
        while inputs.received["base/wrench"] < RATE:
            rclpy.spin_once(inputs, timeout_sec=0.1)
            if time.monotonic() > give_up or node.poll() is not None:
                raise RuntimeError("control publishes no wrench")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(inputs, timeout_sec=0.1)
        return [inputs.values.get(key, "") for key in KEYS]


def main() -> int:
    """Measure the four cases, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="for each case (default 60)")
    options = parser.parse_args()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # busy loops and node do not inherit it
        os.sched_setscheduler(0, policy, os.sched_param(INPUT_PRIORITY))
    except OSError as error:
        print(f"no real-time priority: {error.strerror}", file=sys.stderr)
        return 1
    rclpy.init()
    cases = [(busy, priority) for busy in (False, True) for priority in (False, True)]
    columns = ["beside", "priority", *("50 %", "99 %", "99.9 %") * 2, "missed"]
    table = Table(*columns, title=f"period and latency in ms, {options.seconds:g} s each")
    with Progress(console=Console(stderr=True)) as progress:
        for busy, priority in progress.track(cases, description="jitter"):
            values = measure(options.seconds, busy, priority)
            cells = [f"{float(value):.1f}" for value in values[:-1]]
            beside = "busy loops" if busy else "nothing"
            table.add_row(beside, str(PRIORITY) if priority else "-", *cells, values[-1])
    Console().print(table)
    return int(float(values[KEYS.index("latency p99 [ms]")]) > 1e3 / RATE)


if __name__ == "__main__":
    sys.exit(main())
