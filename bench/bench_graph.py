"""Largest speed of the node graph: testbed, four drivers, calibration and recorder.

With --vehicles 2, each vehicle has drivers and a calibration; with --preset laboratory, the joints
are flexible. One recorder records all topics.

Printed for each multiple of real time: the reached speed, the messages that are missing in the bag,
and the core share of each process. Near a share of 1, the graph saturates.
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
BASE_POSES = [-1.0, -0.6, 0.0], [1.0, 0.6, 3.14159]  # of two vehicles [m, m, rad]
MODULES = {
    "testbed": "fss_sim.testbed_node",
    "link": "fss_arm_driver.link_node",
    "kinematic": "fss_arm_calib.programs:kinematic",
    "record": "fss_arm_bags.record_node",
}


class Vehicle:
    """Names of one vehicle in the graph; without a name, it is the only vehicle."""

    def __init__(self, name: str = "") -> None:
        self.name, namespace = name, f"/{name}" if name else ""
        body, tip = (name, f"{name}_end_effector") if name else ("fss", "end_effector")
        self.remappings = ["--ros-args", "-r", f"__ns:={namespace}"] if name else []
        self.poses = [f"/vicon/{subject}/{subject}" for subject in (body, tip)]
        self.telemetry = [f"{namespace}/link_{i}/telemetry" for i in range(1, LINKS + 1)]


ONLY_VEHICLE = Vehicle()


class Graph:
    """Processes of the graph, in a separate ROS domain."""

    def __init__(
        self, speed: float, folder: Path, vehicles: Sequence[Vehicle], options: argparse.Namespace
    ) -> None:
        self.enter(folder)
        clock = {"use_sim_time": True}
        self.start("record", output=folder / "bag", **clock)
        link_parameters = {
            "timeout": max(1.0, speed),
            "watchdog": 2.0 * max(1.0, speed),
            "rate": options.rate,
        }
        ports = self.domain.ports(2 * LINKS * len(vehicles))
        bed, drivers = ports[: len(ports) // 2], ports[len(ports) // 2 :]
        lines = ["vehicles:"]
        for k, vehicle in enumerate(vehicles):
            self.start("kinematic", vehicle, **clock)
            link_slice = slice(k * LINKS, (k + 1) * LINKS)
            pairs = zip(bed[link_slice], drivers[link_slice], strict=True)
            urls = [f"udp://127.0.0.1:{link}?bind={driver}" for link, driver in pairs]
            if options.driver_processes == 1:
                self.start("link", vehicle, urls=str(urls), **link_parameters, **clock)
            else:
                for i, url in enumerate(urls, 1):
                    self.start(
                        "link", vehicle, f"link_{i}", link=i, url=url, **link_parameters, **clock
                    )
            lines.append(f"  {vehicle.name}: {{ports: {bed[link_slice]}, base: {BASE_POSES[k]}}}")
        is_fleet = len(vehicles) > 1
        (folder / "vehicles.yaml").write_text("\n".join(lines))
        bed_parameters = {"vehicles": folder / "vehicles.yaml"} if is_fleet else {"ports": bed}
        self.start(
            "testbed",
            keep_clock=True,
            speed=speed,
            paused=True,
            telemetry_rate=options.rate,
            preset=options.preset,
            **bed_parameters,
        )

    def enter(self, folder: Path) -> None:
        """Enter an unused ROS domain, with no processes yet."""
        self.domain = next(reserve())
        self.domain.enter()
        self.folder, self.nodes = folder, Nodes(folder, print, self.domain)
        self.processes = self.nodes.processes

    def start(
        self, kind: str, vehicle: Vehicle = ONLY_VEHICLE, name: str = "", **parameters: object
    ) -> None:
        """Start a node's main as a process."""
        module, _, main = MODULES[kind].partition(":")
        code = f"import sys; from {module} import {main or 'main'} as main; sys.exit(main())"
        command = [sys.executable, "-c", code, *vehicle.remappings]
        self.nodes.run(f"{name or kind}{vehicle.name}", command, **parameters)

    def cpu(self) -> dict[str, float]:
        """Return the processor time of each process [s]."""
        times = {}
        for name, process in self.processes.items():
            fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
            times[name] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return times

    def stop(self) -> None:
        """Stop all processes, the test bed first, so that the others process what it has sent."""
        for name in reversed(list(self.processes)):
            self.nodes.stop(name, 60.0)
            if name == "testbed":
                time.sleep(2.0)
        self.nodes.close()


def measure(speed: float, vehicles: Sequence[Vehicle], options: argparse.Namespace) -> bool:
    """Run the graph at a speed and print one row; return True if nothing is missing."""
    import rclpy
    from std_srvs.srv import SetBool

    with TemporaryDirectory(prefix="bench_graph_") as name:
        folder = Path(name)
        graph = Graph(speed, folder, vehicles, options)
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
                    raise RuntimeError(f"the graph does not start within 30 s, see {folder}")
                time.sleep(0.1)
            time.sleep(1.0)
            before, start = graph.cpu(), time.monotonic()
            rclpy.spin_until_future_complete(
                operator, pause.call_async(SetBool.Request(data=False))
            )
            time.sleep(options.seconds / speed)
            rclpy.spin_until_future_complete(operator, pause.call_async(SetBool.Request(data=True)))
            elapsed, after = time.monotonic() - start, graph.cpu()
            time.sleep(2.0)  # for late messages
        finally:
            graph.stop()
            operator.destroy_node()
            rclpy.try_shutdown()
        cpu = {k: after[k] - before[k] for k in after}
        return report(folder / "bag", speed, elapsed, vehicles, cpu)


def report(
    bag: Path, speed: float, elapsed: float, vehicles: Sequence[Vehicle], cpu: dict[str, float]
) -> bool:
    """Print the row of a run; return True if nothing is missing in the bag."""
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
    missing = sent - sum(map(len, sequences.values()))
    shares = [
        sum(v for k, v in cpu.items() if k.startswith(kind))
        for kind in ("testbed", "link", "kinematic", "record")
    ]
    print(
        f"{speed:6g} {frames / 100 / elapsed:8.2f} {len(stamps) * frames:9d} {lost:6d}"
        f" {sent:9d} {missing:6d}   " + " ".join(f"{share / elapsed:9.2f}" for share in shares),
        flush=True,
    )
    return not (lost or missing)


def main() -> int:
    """Measure at each speed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speeds", type=float, nargs="+", default=[1, 5, 10, 15, 20, 30])
    parser.add_argument(
        "--seconds", type=float, default=120.0, help="simulated time at each speed [s]"
    )
    parser.add_argument("--driver-processes", type=int, choices=(1, LINKS), default=1)
    parser.add_argument("--rate", type=float, default=5.0, help="telemetry rate of each link [1/s]")
    parser.add_argument("--vehicles", type=int, choices=(1, 2), default=1)
    parser.add_argument(
        "--preset", default="default", help="preset of the test bed, for example laboratory"
    )
    options = parser.parse_args()
    vehicles = [ONLY_VEHICLE] if options.vehicles == 1 else [Vehicle("fss1"), Vehicle("fss2")]
    print(
        f"{os.cpu_count()} cores, {options.driver_processes} driver process(es), "
        f"telemetry {options.rate:g}/s, {options.seconds:g} s simulated each"
    )
    print(
        " speed  reached     VICON   lost telemetry   lost   cores: "
        "testbed drivers kinematic record"
    )
    complete = [measure(speed, vehicles, options) for speed in options.speeds]
    print(
        f"nothing lost at speeds "
        f"{[s for s, ok in zip(options.speeds, complete, strict=True) if ok]}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
