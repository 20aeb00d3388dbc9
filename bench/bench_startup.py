"""What starting takes: `--help` of every executable, and every node from `ros2 run` to ready.

Processor time of the process and what it starts, the least of several runs. A node is ready once it
answers a request for its parameters. Then nobody talks to it, and its share of a core is taken.
Beside them the floor: Python, with rclpy and one node; with numba; with rerun.
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
HELP, READY, IDLE = 0.3, 1.0, 1.0  # the most: [s], [s], [% of a core]
URLS = [f"udp://127.0.0.1:{49001 + 2 * i}?bind={49002 + 2 * i}" for i in range(5)]

# What a node needs to stay; the others need nothing.
NEEDS = {
    "fss_arm_driver link": {"url": URLS[0]},
    "fss_arm_driver driver": {"urls": str(URLS[:4])},
    "fss_base_driver base": {"url": URLS[4]},
    "fss_base_driver fog": {"device": "{gyro}"},
    "fss_base_driver mocap": {"relays": "[fss=/elsewhere]"},
    "fss_arm_view view": {"mode": "file", "file": "{folder}/view.rrd"},
    "fss_arm_bags record": {"output": "{folder}/bags"},
}
ENDS = {"replay"}  # by itself, for want of a bag

FLOORS = {
    "python": "pass",
    "rclpy": "import rclpy; rclpy.init(); rclpy.create_node('floor')",
    "rclpy, numba": "import numba, rclpy; rclpy.init(); rclpy.create_node('floor')",
    "rclpy, rerun": "import rerun, rclpy; rclpy.init(); rclpy.create_node('floor')",
}


def executables() -> list[tuple[str, str, bool]]:
    """Package and name of each, and whether it is a node that stays."""
    packages = sorted(path.parent.name for path in ROOT.glob("src/*/setup.py"))
    entries = [(p, e) for p in packages for e in distribution(p).entry_points]
    return [(p, e.name, type(e.load()) is Program and e.name not in ENDS) for p, e in entries]


def least(command: list[str], runs: int) -> float:
    """Processor time of a command that ends by itself [s]."""
    took = []
    for _ in range(runs):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        took.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(took)


def taken(pid: int) -> float:
    """Processor time of a process and its ended children [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def start(package: str, name: str, places: dict[str, str], idle: float) -> tuple[float, float]:
    """Processor time until a node is ready [s], and its share of a core then [%]."""
    import rclpy
    from rcl_interfaces.srv import ListParameters

    given = []
    for key, value in NEEDS.get(f"{package} {name}", {}).items():
        given += ["-p", f"{key}:={value.format(**places)}"]
    me = rclpy.create_node("bench")
    node = "link_1" if name in ("link", "driver") else name
    client = me.create_client(ListParameters, f"/{node}/list_parameters")
    path = Path(places["folder"], f"{name}.log")
    with path.open("w") as log:
        process = subprocess.Popen(
            ["ros2", "run", package, name, "--ros-args", *given], stdout=log, stderr=log
        )
    try:
        deadline = time.monotonic() + 60.0
        while not client.wait_for_service(0.01):
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"{package} {name}: {path.read_text()}")
        future = client.call_async(ListParameters.Request())
        rclpy.spin_until_future_complete(me, future, timeout_sec=30.0)
        ready = taken(process.pid)
        time.sleep(1.0)
        before, begin = taken(process.pid), time.monotonic()
        time.sleep(idle)
        share = (taken(process.pid) - before) / (time.monotonic() - begin)
        return ready, 100.0 * share
    finally:
        process.terminate()
        try:
            process.wait(15.0)
        except subprocess.TimeoutExpired:
            process.kill()
        me.destroy_node()


def main() -> int:
    """Measure, and print a table."""
    import rclpy

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="package, or package and name")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--idle", type=float, default=5.0, help="time to look at idle nodes [s]")
    options = parser.parse_args()
    domain = next(reserve())
    domain.enter()
    rclpy.init()
    print("floor, processor time [s]:")
    for name, code in FLOORS.items():
        print(f"  {name:30} {least([sys.executable, '-c', code], options.runs):.2f}", flush=True)
    print(f"{'':32} --help [s]  ready [s]  idle [%]")
    missed = 0
    with TemporaryDirectory(prefix="bench_startup_") as folder:
        places = {"folder": folder, "gyro": os.ttyname(os.openpty()[1])}
        for package, name, stays in executables():
            if not f"{package} {name}".startswith(options.only):
                continue
            helped = least(["ros2", "run", package, name, "--help"], options.runs)
            row, late = f"{package + ' ' + name:32} {helped:10.2f}", helped > HELP
            if stays:
                found = [start(package, name, places, options.idle) for _ in range(options.runs)]
                ready, idle = (min(column) for column in zip(*found, strict=True))
                row += f" {ready:10.2f} {idle:9.2f}"
                late |= ready > READY or idle > IDLE
            print(row + ("  above the aim" if late else ""), flush=True)
            missed += late
    rclpy.try_shutdown()
    print(f"{missed} above the aims of {HELP} s, {READY} s, {IDLE} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())
