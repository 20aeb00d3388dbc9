"""Control laws in their processes: latency beside a bare node, and what follows a fault.

`latency`: a source publishes base/state, and the node `controller` runs each form of the PD law at
the same rate. Beside it a bare rclpy node publishes a wrench in the callback of base/state. Latency
is from the stamp of the state to the publication of the wrench.

`faults`: laws that fail while they command wrench and joints. Valves are closed and joints held
once the node publishes zeros, or at the latest when the last command has expired.

    . scripts/env.sh; python bench/bench_law.py latency; python bench/bench_law.py faults
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState

from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import subscribe_sensor

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "test/support"), str(ROOT / "scripts")]

import fmu  # noqa: E402
import gnc_bench  # noqa: E402

LAWS = ROOT / "docs/examples/laws"
RATES = 100.0, 250.0  # [1/s]
PERCENTS = 50.0, 99.0, 99.9
FAULTS = {
    "Exceptional": "exception",
    "Segmentation": "SIGSEGV",
    "Endless": "endless loop",
    "Leak": "2 GB",
    "NotANumber": "NaN",
    "Good": "SIGKILL",
    "Late": "10 periods late",
}
TOTAL = 100  # faults
TIME_TO_LIVE = 0.3  # default of controller, and of the base's node for a wrench [s]
LATE_TIME_TO_LIVE = 0.1  # with which ten periods of 50 Hz are late [s]
TIMEOUT = 60.0  # [s]


class Echo(Node):
    """Publishes a wrench for each state."""

    def __init__(self) -> None:
        super().__init__("echo")
        self.ages: list[int] = []
        self.wrench = self.create_publisher(WrenchStamped, "base/wrench", 1)
        subscribe_sensor(self, Odometry, "base/state", self.on_base)

    def on_base(self, message: Odometry) -> None:
        """Answer a state."""
        self.wrench.publish(WrenchStamped(header=message.header))
        self.ages.append(time.time_ns() - stamp_ns(message.header.stamp))


class Craft(gnc_bench.FakeCraft):
    """Publishes states, and keeps the commands and the diagnostics of `controller`."""

    def __init__(self) -> None:
        super().__init__()
        self.wrenches: list[tuple[int, int, bool]] = []  # receipt, stamp [ns], is it zero
        self.rates: list[tuple[int, int, bool]] = []
        self.status: dict[str, str] = {}
        self.create_subscription(WrenchStamped, "base/wrench", self.on_wrench, 100)
        self.create_subscription(JointState, "arm/joint_commands", self.on_rates, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_report, 10)

    def on_wrench(self, message: WrenchStamped) -> None:
        """Store a wrench."""
        force, torque = message.wrench.force, message.wrench.torque
        row = self.now(), stamp_ns(message.header.stamp), not (force.x or force.y or torque.z)
        self.wrenches.append(row)

    def on_rates(self, message: JointState) -> None:
        """Store the rates of the joints."""
        row = self.now(), stamp_ns(message.header.stamp), not any(message.velocity)
        self.rates.append(row)

    def on_report(self, message: DiagnosticArray) -> None:
        """Store the values of `controller`."""
        for status in message.status:
            if status.name == "/controller":
                self.status = {value.key: value.value for value in status.values}


def spin(executor: SingleThreadedExecutor, until: Callable[[], Any]) -> None:
    """Run the nodes until a condition holds."""
    deadline = time.monotonic() + TIMEOUT
    while not until():
        if time.monotonic() > deadline:
            raise TimeoutError("no progress")
        executor.spin_once(timeout_sec=0.02)


def latency(form: str, law: str, rate: float, seconds: float) -> list[str]:
    """Return a row of the table: form, rate, percentiles [ms], missed deadlines."""
    if law:
        parameters = ["--ros-args", "-p", f"law:={law}", "-p", f"rate:={rate}"]
        command = [sys.executable, "-m", "fss_gnc.controller_node", *parameters]
    else:
        command = [sys.executable, __file__, "echo"]
    gnc_bench.RATE = rate
    craft, executor = Craft(), SingleThreadedExecutor()
    executor.add_node(craft)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        spin(executor, lambda: craft.wrenches)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.02)
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=TIMEOUT)
        executor.remove_node(craft)
        craft.destroy_node()
    if law:
        values = [float(craft.status[f"latency p{p:g} [ms]"]) for p in PERCENTS]
        missed = craft.status["missed deadlines"]
    else:
        values, missed = [float(word) for word in output.split()], ""
    return [form, f"{rate:g}", *(f"{value:.1f}" for value in values), missed]


def echo() -> None:
    """Answer states until interrupted, then print percentiles of the latency [ms]."""
    rclpy.init()
    node = Echo()
    try:
        rclpy.spin(node)
    except BaseException:
        print(*np.percentile(1e-6 * np.array(node.ages), PERCENTS))


def fault(name: str, number: int) -> tuple[float, float]:
    """Return times from the inputs of the last command to closed valves, and to held joints [s].

    Raises:
        AssertionError: a command follows the fault.
    """
    from fss_gnc.controller_node import ControllerNode

    law, is_late = f"{ROOT}/test/support/faulty_laws.py:{name}", name == "Late"
    time_to_live = LATE_TIME_TO_LIVE if is_late else TIME_TO_LIVE
    values = {"law": law, "rate": 50.0, "time_to_live": time_to_live}
    overrides = [Parameter(key, value=value) for key, value in values.items()]
    craft, controller = Craft(), ControllerNode(parameter_overrides=overrides)
    executor = SingleThreadedExecutor()
    for node in (craft, controller):
        executor.add_node(node)
    try:
        spin(executor, lambda: len(craft.wrenches) > number % 7 and craft.rates)
        if name == "Good":
            os.kill(controller.process.pid, signal.SIGKILL)
        spin(executor, lambda: craft.wrenches[-1][2] and craft.rates[-1][2])
        times = []
        for rows, lifetime in ((craft.wrenches, time_to_live), (craft.rates, 0.5)):
            stop, _, _ = rows[-1]
            last = max(stamp for _, stamp, is_zero in rows if not is_zero)
            times.append(min((stop - last) / SECOND, lifetime))
        if is_late:  # commands resume
            spin(executor, lambda: not (craft.wrenches[-1][2] or craft.rates[-1][2]))
        else:
            end = time.monotonic() + 0.5
            spin(executor, lambda: time.monotonic() > end)
            assert craft.wrenches[-1][2]
            assert craft.rates[-1][2]
            spin(executor, lambda: controller.law.failure)
        return times[0], times[1]
    finally:
        controller.close()
        for node in (craft, controller):
            executor.remove_node(node)
            node.destroy_node()


def measure_latency(seconds: float) -> int:
    """Print the table of latencies."""
    table = Table(*("form", "rate [Hz]", *(f"p{p:g} [ms]" for p in PERCENTS), "missed deadlines"))
    with TemporaryDirectory() as folder:
        library, unit = f"{folder}/pd_hold.so", Path(folder) / "pd_hold.fmu"
        source = str(LAWS / "pd_hold.c")
        subprocess.run(["cc", *fmu.FLAGS, "-o", library, source, "-lm"], check=True)
        fmu.export(fmu.law_model(LAWS / "pd_hold.c"), 2, unit)
        forms = {"bare node": "", "Python": f"{LAWS}/pd_hold.py:PdHold"}
        forms |= {"C": library, "FMU": str(unit)}
        for rate in RATES:
            for form, law in forms.items():
                table.add_row(*latency(form, law, rate, seconds))
    Console(width=80).print(table)
    return 0


def measure_faults() -> int:
    """Print the table of faults; return 1 if a command followed one."""
    table = Table("fault", "runs", "stopped", "valves closed [ms]", "joints held [ms]")
    failed, names = Counter[str](), list(FAULTS)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for number in range(TOTAL):
        name = names[number % len(names)]
        try:
            times[name].append(fault(name, number))
        except (AssertionError, TimeoutError) as error:
            failed[name] += 1
            print(f"{FAULTS[name]}: {type(error).__name__} {error}", file=sys.stderr)
    for name in names:
        runs, rows = len(times[name]) + failed[name], 1e3 * np.array(times[name])
        texts = [f"{np.median(row):.0f}, at most {row.max():.0f}" for row in rows.T]
        table.add_row(FAULTS[name], str(runs), str(len(rows)), *texts)
    Console(width=80).print(table)
    return 1 if failed else 0


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["latency", "faults", "echo"])
    parser.add_argument("--seconds", type=float, default=42.0, help="of each form and rate")
    given = parser.parse_args()
    if given.what == "echo":
        echo()
        return 0
    rclpy.init()
    return measure_latency(given.seconds) if given.what == "latency" else measure_faults()


if __name__ == "__main__":
    sys.exit(main())
