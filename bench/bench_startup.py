"""Startup time: `--help` of every executable, and every node from `ros2 run` to ready.

Processor time of the process and its children, the smallest of several runs. A node is ready when
it answers a parameter request. Then its core share without any requests is measured. For
comparison: Python with rclpy and one node; with numba; with rerun.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from importlib.metadata import distribution
from pathlib import Path
from tempfile import TemporaryDirectory

from fss_arm_ros.program import Program
from fss_rehearsal.domain import reserve

ROOT = Path(__file__).resolve().parents[1]
MAX_HELP_TIME, MAX_READY_TIME, MAX_IDLE_SHARE = 0.3, 1.0, 1.0  # [s], [s], [% of a core]
URLS = [f"udp://127.0.0.1:{49001 + 2 * i}?bind={49002 + 2 * i}" for i in range(5)]

# Parameters that a node needs to keep running; the others need none.
PARAMETERS = {
    "fss_arm_driver link": {"url": URLS[0]},
    "fss_arm_driver driver": {"urls": str(URLS[:4])},
    "fss_base_driver base": {"url": URLS[4]},
    "fss_base_driver fog": {"device": "{gyro}"},
    "fss_base_driver mocap": {"relays": "[fss=/elsewhere]"},
    "fss_arm_view view": {"mode": "file", "file": "{folder}/view.rrd"},
    "fss_arm_bags record": {"output": "{folder}/bags"},
}
SHORT_LIVED = {"replay"}  # exits without a bag

FLOORS = {
    "python": "pass",
    "rclpy": "import rclpy; rclpy.init(); rclpy.create_node('floor')",
    "rclpy, numba": "import numba, rclpy; rclpy.init(); rclpy.create_node('floor')",
    "rclpy, rerun": "import rerun, rclpy; rclpy.init(); rclpy.create_node('floor')",
}


def executables() -> list[tuple[str, str, bool]]:
    """Return package and name of each executable, and whether it is a node that keeps running."""
    packages = sorted(path.parent.name for path in ROOT.glob("src/*/setup.py"))
    entries = [(p, e) for p in packages for e in distribution(p).entry_points]
    return [
        (p, e.name, type(e.load()) is Program and e.name not in SHORT_LIVED) for p, e in entries
    ]


def min_processor_time(command: list[str], runs: int) -> float:
    """Return the smallest processor time of a command [s]."""
    times = []
    for _ in range(runs):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def processor_time(pid: int) -> float:
    """Return the processor time of a process and its finished children [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def start(package: str, name: str, values: dict[str, str], idle: float) -> tuple[float, float]:
    """Return the processor time until a node is ready [s], and then its core share [%]."""
    import rclpy
    from rcl_interfaces.srv import ListParameters

    arguments = []
    for key, value in PARAMETERS.get(f"{package} {name}", {}).items():
        arguments += ["-p", f"{key}:={value.format(**values)}"]
    client_node = rclpy.create_node("bench")
    node = "link_1" if name in ("link", "driver") else name
    client = client_node.create_client(ListParameters, f"/{node}/list_parameters")
    path = Path(values["folder"], f"{name}.log")
    with path.open("w") as log:
        process = subprocess.Popen(
            ["ros2", "run", package, name, "--ros-args", *arguments], stdout=log, stderr=log
        )
    try:
        deadline = time.monotonic() + 60.0
        while not client.wait_for_service(0.01):
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"{package} {name}: {path.read_text()}")
        future = client.call_async(ListParameters.Request())
        rclpy.spin_until_future_complete(client_node, future, timeout_sec=30.0)
        ready = processor_time(process.pid)
        time.sleep(1.0)
        before, start_time = processor_time(process.pid), time.monotonic()
        time.sleep(idle)
        share = (processor_time(process.pid) - before) / (time.monotonic() - start_time)
        return ready, 100.0 * share
    finally:
        process.terminate()
        try:
            process.wait(15.0)
        except subprocess.TimeoutExpired:
            process.kill()
        client_node.destroy_node()


def main() -> int:
    """Measure and print a table."""
    import rclpy

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="only this package, or package and name")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument(
        "--idle", type=float, default=5.0, help="observation time of idle nodes [s]"
    )
    options = parser.parse_args()
    domain = next(reserve())
    domain.enter()
    rclpy.init()
    print("for comparison, processor time [s]:")
    for name, code in FLOORS.items():
        print(
            f"  {name:30} {min_processor_time([sys.executable, '-c', code], options.runs):.2f}",
            flush=True,
        )
    print(f"{'':32} --help [s]  ready [s]  idle [%]")
    exceeded = 0
    with TemporaryDirectory(prefix="bench_startup_") as folder:
        values = {"folder": folder, "gyro": os.ttyname(os.openpty()[1])}
        for package, name, is_node in executables():
            if not f"{package} {name}".startswith(options.only):
                continue
            help_time = min_processor_time(["ros2", "run", package, name, "--help"], options.runs)
            row, exceeds = f"{package + ' ' + name:32} {help_time:10.2f}", help_time > MAX_HELP_TIME
            if is_node:
                found = [start(package, name, values, options.idle) for _ in range(options.runs)]
                ready, idle = (min(column) for column in zip(*found, strict=True))
                row += f" {ready:10.2f} {idle:9.2f}"
                exceeds |= ready > MAX_READY_TIME or idle > MAX_IDLE_SHARE
            print(row + ("  above the limit" if exceeds else ""), flush=True)
            exceeded += exceeds
    rclpy.try_shutdown()
    print(
        f"{exceeded} above the limits of {MAX_HELP_TIME} s, {MAX_READY_TIME} s, {MAX_IDLE_SHARE} %"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
