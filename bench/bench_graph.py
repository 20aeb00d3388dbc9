"""How fast the node graph can run: testbed, four drivers, calibration and recorder.

For each multiple of real time: the speed reached, which messages were lost on the way into the bag,
and the share of a core that each process took: where that comes near 1, the graph saturates.
"""

import argparse
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from fss_arm_bags.reader import open_bags
from fss_arm_ros.convert import stamp_ns
from fss_sim.rehearsal.domain import reserve
from fss_sim.rehearsal.processes import Nodes

LINKS = 4
VICON = ["/vicon/fss/fss", "/vicon/end_effector/end_effector"]
TELEMETRY = [f"/link_{i}/telemetry" for i in range(1, LINKS + 1)]
MODULES = {
    "testbed": "fss_sim.testbed_node",
    "link": "fss_arm_driver.link_node",
    "kinematic": "fss_arm_calib.calibration_node:kinematic",
    "record": "fss_arm_bags.record_node",
}


class Graph:
    """The processes, in a ROS domain of their own, and what they take."""

    def __init__(self, speed: float, folder: Path, processes: int, rate: float) -> None:
        self.enter(folder)
        clock = {"use_sim_time": True}
        self.start("record", output=folder / "bag", **clock)
        self.start("kinematic", **clock)
        urls = self.domain.urls(LINKS)
        patience = {"timeout": max(1.0, speed), "watchdog": 2.0 * max(1.0, speed), "rate": rate}
        if processes == 1:
            self.start("link", urls=str(urls), **patience, **clock)
        else:
            for i, url in enumerate(urls, 1):
                self.start("link", f"link_{i}", link=i, url=url, **patience, **clock)
        self.start(
            "testbed", keep_clock=True, speed=speed, ports=self.domain.ports(LINKS), paused=True,
            telemetry_rate=rate,
        )  # fmt: skip

    def enter(self, folder: Path) -> None:
        """Have no processes yet, in a domain where nobody is."""
        self.domain = next(reserve())
        self.domain.enter()
        self.folder, self.nodes = folder, Nodes(folder, print, self.domain)
        self.processes = self.nodes.processes

    def start(self, what: str, name: str = "", **parameters: object) -> None:
        """Start a node's main as a process."""
        module, _, main = MODULES[what].partition(":")
        code = f"import sys; from {module} import {main or 'main'} as main; sys.exit(main())"
        self.nodes.run(name or what, [sys.executable, "-c", code], **parameters)

    def cpu(self) -> dict[str, float]:
        """Time that each has taken [s]."""
        taken = {}
        for name, process in self.processes.items():
            fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
            taken[name] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return taken

    def stop(self) -> None:
        """The testbed first, so that the others take what is under way."""
        for name in reversed(list(self.processes)):
            self.nodes.stop(name, 60.0)
            if name == "testbed":
                time.sleep(2.0)
        self.nodes.close()


def measure(speed: float, seconds: float, processes: int, rate: float) -> bool:
    """Run the graph at a multiple of real time and print one row; whether nothing was lost."""
    import rclpy
    from std_srvs.srv import SetBool

    with TemporaryDirectory(prefix="bench_graph_") as name:
        folder = Path(name)
        graph = Graph(speed, folder, processes, rate)
        rclpy.init()
        operator = rclpy.create_node("operator")
        pause = operator.create_client(SetBool, "sim/pause")
        try:
            pause.wait_for_service(30.0)
            deadline = time.monotonic() + 30.0
            while (
                operator.count_subscribers(VICON[0]) < 2
                or operator.count_subscribers(TELEMETRY[-1]) < 1
            ):
                if time.monotonic() > deadline:
                    raise RuntimeError(f"the graph does not come up, see {folder}")
                time.sleep(0.1)
            time.sleep(1.0)
            before, begin = graph.cpu(), time.monotonic()
            rclpy.spin_until_future_complete(
                operator, pause.call_async(SetBool.Request(data=False))
            )
            time.sleep(seconds / speed)
            rclpy.spin_until_future_complete(operator, pause.call_async(SetBool.Request(data=True)))
            took, after = time.monotonic() - begin, graph.cpu()
            time.sleep(2.0)  # for those who lag
        finally:
            graph.stop()
            operator.destroy_node()
            rclpy.try_shutdown()
        return report(folder / "bag", speed, took, {k: after[k] - before[k] for k in after})


def report(bag: Path, speed: float, took: float, cpu: dict[str, float]) -> bool:
    """Print what came of a run."""
    stamps: dict[str, list[int]] = {topic: [] for topic in VICON}
    sequences: dict[str, list[int]] = {topic: [] for topic in TELEMETRY}
    with open_bags(bag) as bags:
        for topic, _, _, message in bags.messages({*VICON, *TELEMETRY}):
            if topic in stamps:
                stamps[topic].append(stamp_ns(message.header.stamp))
            else:
                sequences[topic].append(message.sequence)
    frames = max((s[-1] - s[0]) // 10_000_000 + 1 for s in stamps.values())
    lost = sum(frames - len(s) for s in stamps.values())
    sent = sum(s[-1] - s[0] + 1 for s in sequences.values())
    missed = sent - sum(map(len, sequences.values()))
    links = [v for k, v in cpu.items() if k.startswith("link")]
    shares = {"testbed": cpu["testbed"], "drivers": sum(links), "kinematic": cpu["kinematic"],
              "record": cpu["record"]}  # fmt: skip
    print(
        f"{speed:6g} {frames / 100 / took:8.2f} {2 * frames:9d} {lost:6d} {sent:9d} {missed:6d}   "
        + " ".join(f"{v / took:9.2f}" for v in shares.values()),
        flush=True,
    )
    return not (lost or missed)


def main() -> int:
    """Sweep the multiples."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speeds", type=float, nargs="+", default=[1, 5, 10, 15, 20, 30])
    parser.add_argument("--seconds", type=float, default=120.0, help="simulated, each speed")
    parser.add_argument("--driver-processes", type=int, choices=(1, LINKS), default=1)
    parser.add_argument("--rate", type=float, default=5.0, help="telemetry of each link [1/s]")
    options = parser.parse_args()
    print(f"{os.cpu_count()} cores, {options.driver_processes} driver process(es), "
          f"telemetry {options.rate:g}/s, {options.seconds:g} s simulated each")  # fmt: skip
    print(" asked  reached     VICON   lost telemetry   lost   cores: "
          "testbed drivers kinematic record")  # fmt: skip
    good = [measure(s, options.seconds, options.driver_processes, options.rate)
            for s in options.speeds]  # fmt: skip
    print(f"nothing lost at "
          f"{[s for s, ok in zip(options.speeds, good, strict=True) if ok]}")  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
