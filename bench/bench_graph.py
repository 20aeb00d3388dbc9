"""How fast the node graph can run: testbed, four drivers, calibration and recorder.

With --vehicles 2, each of them has drivers and calibration, and --preset laboratory lets its joints
give; the recorder takes all.

For each multiple of real time: the speed reached, which messages were lost on the way into the bag,
and the share of a core that each process took: where that comes near 1, the graph saturates.
"""

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from fss_arm_bags.reader import open_bags
from fss_arm_ros.convert import stamp_ns
from fss_rehearsal.domain import reserve
from fss_rehearsal.processes import Nodes

LINKS = 4
PLACES = [-1.0, -0.6, 0.0], [1.0, 0.6, 3.14159]  # of two vehicles
MODULES = {
    "testbed": "fss_sim.testbed_node",
    "link": "fss_arm_driver.link_node",
    "kinematic": "fss_arm_calib.calibration_node:kinematic",
    "record": "fss_arm_bags.record_node",
}


class Vehicle:
    """What one of them has in the graph; without a name it is the only one."""

    def __init__(self, name: str = "") -> None:
        self.name, within = name, f"/{name}" if name else ""
        body, tip = (name, f"{name}_end_effector") if name else ("fss", "end_effector")
        self.remapped = ["--ros-args", "-r", f"__ns:={within}"] if name else []
        self.poses = [f"/vicon/{subject}/{subject}" for subject in (body, tip)]
        self.telemetry = [f"{within}/link_{i}/telemetry" for i in range(1, LINKS + 1)]


ALONE = Vehicle()


class Graph:
    """The processes, in a ROS domain of their own, and what they take."""

    def __init__(
        self, speed: float, folder: Path, vehicles: Sequence[Vehicle], given: argparse.Namespace
    ) -> None:
        self.enter(folder)
        clock = {"use_sim_time": True}
        self.start("record", output=folder / "bag", **clock)
        patience = {
            "timeout": max(1.0, speed), "watchdog": 2.0 * max(1.0, speed), "rate": given.rate,
        }  # fmt: skip
        ports = self.domain.ports(2 * LINKS * len(vehicles))
        bed, drivers = ports[: len(ports) // 2], ports[len(ports) // 2 :]
        lines = ["vehicles:"]
        for k, vehicle in enumerate(vehicles):
            self.start("kinematic", vehicle, **clock)
            own = slice(k * LINKS, (k + 1) * LINKS)
            pairs = zip(bed[own], drivers[own], strict=True)
            urls = [f"udp://127.0.0.1:{link}?bind={driver}" for link, driver in pairs]
            if given.driver_processes == 1:
                self.start("link", vehicle, urls=str(urls), **patience, **clock)
            else:
                for i, url in enumerate(urls, 1):
                    self.start("link", vehicle, f"link_{i}", link=i, url=url, **patience, **clock)
            lines.append(f"  {vehicle.name}: {{ports: {bed[own]}, base: {PLACES[k]}}}")
        several = len(vehicles) > 1
        (folder / "vehicles.yaml").write_text("\n".join(lines))
        place = {"vehicles": folder / "vehicles.yaml"} if several else {"ports": bed}
        self.start(
            "testbed", keep_clock=True, speed=speed, paused=True, telemetry_rate=given.rate,
            preset=given.preset, **place,
        )  # fmt: skip

    def enter(self, folder: Path) -> None:
        """Have no processes yet, in a domain where nobody is."""
        self.domain = next(reserve())
        self.domain.enter()
        self.folder, self.nodes = folder, Nodes(folder, print, self.domain)
        self.processes = self.nodes.processes

    def start(self, what: str, of: Vehicle = ALONE, name: str = "", **parameters: object) -> None:
        """Start a node's main as a process."""
        module, _, main = MODULES[what].partition(":")
        code = f"import sys; from {module} import {main or 'main'} as main; sys.exit(main())"
        command = [sys.executable, "-c", code, *of.remapped]
        self.nodes.run(f"{name or what}{of.name}", command, **parameters)

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


def measure(speed: float, vehicles: Sequence[Vehicle], given: argparse.Namespace) -> bool:
    """Run the graph at a multiple of real time and print one row; whether nothing was lost."""
    import rclpy
    from std_srvs.srv import SetBool

    with TemporaryDirectory(prefix="bench_graph_") as name:
        folder = Path(name)
        graph = Graph(speed, folder, vehicles, given)
        rclpy.init()
        operator = rclpy.create_node("operator")
        pause = operator.create_client(SetBool, "sim/pause")
        try:
            pause.wait_for_service(30.0)
            deadline = time.monotonic() + 30.0
            while any(
                operator.count_subscribers(vehicle.poses[0]) < 2
                or operator.count_subscribers(vehicle.telemetry[-1]) < 1
                for vehicle in vehicles
            ):
                if time.monotonic() > deadline:
                    raise RuntimeError(f"the graph does not come up, see {folder}")
                time.sleep(0.1)
            time.sleep(1.0)
            before, begin = graph.cpu(), time.monotonic()
            rclpy.spin_until_future_complete(
                operator, pause.call_async(SetBool.Request(data=False))
            )
            time.sleep(given.seconds / speed)
            rclpy.spin_until_future_complete(operator, pause.call_async(SetBool.Request(data=True)))
            took, after = time.monotonic() - begin, graph.cpu()
            time.sleep(2.0)  # for those who lag
        finally:
            graph.stop()
            operator.destroy_node()
            rclpy.try_shutdown()
        cpu = {k: after[k] - before[k] for k in after}
        return report(folder / "bag", speed, took, vehicles, cpu)


def report(
    bag: Path, speed: float, took: float, vehicles: Sequence[Vehicle], cpu: dict[str, float]
) -> bool:
    """Print what came of a run."""
    stamps: dict[str, list[int]] = {topic: [] for v in vehicles for topic in v.poses}
    sequences: dict[str, list[int]] = {topic: [] for v in vehicles for topic in v.telemetry}
    with open_bags(bag) as bags:
        for topic, _, _, message in bags.messages({*stamps, *sequences}):
            if topic in stamps:
                stamps[topic].append(stamp_ns(message.header.stamp))
            else:
                sequences[topic].append(message.sequence)
    frames = max((s[-1] - s[0]) // 10_000_000 + 1 for s in stamps.values())
    lost = sum(frames - len(s) for s in stamps.values())
    sent = sum(s[-1] - s[0] + 1 for s in sequences.values())
    missed = sent - sum(map(len, sequences.values()))
    shares = [sum(v for k, v in cpu.items() if k.startswith(what))
              for what in ("testbed", "link", "kinematic", "record")]  # fmt: skip
    print(
        f"{speed:6g} {frames / 100 / took:8.2f} {len(stamps) * frames:9d} {lost:6d}"
        f" {sent:9d} {missed:6d}   " + " ".join(f"{share / took:9.2f}" for share in shares),
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
    parser.add_argument("--vehicles", type=int, choices=(1, 2), default=1)
    parser.add_argument("--preset", default="default", help="of the test bed, as laboratory")
    options = parser.parse_args()
    vehicles = [ALONE] if options.vehicles == 1 else [Vehicle("fss1"), Vehicle("fss2")]
    print(f"{os.cpu_count()} cores, {options.driver_processes} driver process(es), "
          f"telemetry {options.rate:g}/s, {options.seconds:g} s simulated each")  # fmt: skip
    print(" asked  reached     VICON   lost telemetry   lost   cores: "
          "testbed drivers kinematic record")  # fmt: skip
    good = [measure(speed, vehicles, options) for speed in options.speeds]
    print(f"nothing lost at "
          f"{[s for s, ok in zip(options.speeds, good, strict=True) if ok]}")  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
