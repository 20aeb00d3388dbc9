"""What recording everything costs, and whether anything is lost, with links at 500 frames a second.

The real drivers and test bed at five times real time, 100 simulated frames a second of each link:
500 a second on the wire and on topics, as of VICON, FOG and /clock. The recorder runs as always,
flushing twice a second; beside it a bare raw subscription to the same topics that only counts. Then
rosbags' writer alone writes the same messages from memory.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from itertools import islice, pairwise
from pathlib import Path
from statistics import fmean, median
from tempfile import TemporaryDirectory

import rclpy
from bench_graph import LINKS, MODULES, TELEMETRY, VICON, Graph
from rosbags.rosbag2 import StoragePlugin, Writer
from std_srvs.srv import SetBool

from fss_arm_bags.reader import Bags, open_bags
from fss_arm_ros.convert import stamp_ns
from fss_sim.testbed import FRAME
from fss_sim.testbed_node import TOGETHER

SPEED, RATE = 5.0, 100.0
STEADY = [*VICON, "/fog/imu"]  # a message each frame
os.environ["PYTHONPATH"] = f"{Path(__file__).parent}:{os.environ.get('PYTHONPATH', '')}"
MODULES |= {"count": "raw_counter", "arm": "fss_arm_driver.arm_node"}


def run_graph(folder: Path, seconds: float) -> tuple[dict[str, float], float]:
    """Run for a time [s]; what each process took of the processor [s], and how long it was."""
    graph = Graph(SPEED, folder, LINKS, RATE)
    graph.start("arm", use_sim_time=True)
    graph.start("count", use_sim_time=True)
    rclpy.init()
    operator = rclpy.create_node("operator")
    pause = operator.create_client(SetBool, "sim/pause")

    def paused(data: bool) -> None:
        done = pause.call_async(SetBool.Request(data=data))
        rclpy.spin_until_future_complete(operator, done)

    try:
        deadline = time.monotonic() + 60.0
        while operator.count_subscribers(TELEMETRY[-1]) < 3:  # recorder, counter, arm
            if time.monotonic() > deadline:
                raise RuntimeError(f"the graph does not come up, see {folder}")
            time.sleep(0.1)
        pause.wait_for_service(30.0)
        time.sleep(2.0)
        paused(False)
        before, begin = graph.cpu(), time.monotonic()
        time.sleep(seconds)
        after, took = graph.cpu(), time.monotonic() - begin
        paused(True)
        time.sleep(3.0)  # for those who lag
    finally:
        graph.stop()
        operator.destroy_node()
        rclpy.try_shutdown()
    return {name: after[name] - before[name] for name in after}, took


def lost(bags: Bags) -> dict[str, int]:
    """What is missing of what the drivers say they published, and of steady topics by their stamps.

    Frames that were lost on the wire, or came to a driver that had lost the link, no recorder has.
    """
    said: Counter[str] = Counter()
    missed: Counter[str] = Counter()
    for _, _, _, message in bags.messages({"/diagnostics"}):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "believed" in values:
                said[f"{status.name}/telemetry"] = int(values["believed"])
                missed[status.name] = int(values.get("missed", 0))
    print("missed by the drivers, on the wire:", missed.total())
    if silent := set(TELEMETRY) - set(said):
        raise RuntimeError(f"no diagnostics of {', '.join(sorted(silent))}")
    said["/joint_states"] = said.total()
    missing = {
        topic: max(0, number - bags.topics[topic].messages) for topic, number in said.items()
    }
    stamps: dict[str, list[int]] = {topic: [] for topic in STEADY}
    for topic, _, _, message in bags.messages(set(STEADY)):
        stamps[topic].append(stamp_ns(message.header.stamp) // FRAME)
    missing |= {topic: n[-1] - n[0] + 1 - len(n) for topic, n in stamps.items()}
    clock = [stamp_ns(message.clock) // FRAME for *_, message in bags.messages({"/clock"})]
    missing["/clock"] = sum((b - a - 1) // TOGETHER for a, b in pairwise(clock))  # at least
    return missing


def links_rates(bags: Bags) -> list[float]:
    """Telemetry of a link in each real second that the test bed ran [1/s], as it says itself."""
    rates = []
    for _, _, _, message in bags.messages({"/diagnostics"}):
        for status in message.status:
            if status.name == "/testbed" and not status.message.startswith("paused"):
                values = {pair.key: pair.value for pair in status.values}
                rates.append(RATE * float(values["speed"]))
    return rates[1:-1]  # whole seconds


def stolen() -> float:
    """Time that other machines on this host have taken from all cores [s]."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


def write_alone(bags: Bags, path: Path) -> float:
    """Time of rosbags' writer for a message [s], many of them in memory before."""
    messages = list(islice(bags.raw(), 300_000))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            name: writer.add_connection(
                name, topic.msgtype, msgdef=topic.definition, rihs01=topic.hash
            )
            for name, topic in bags.topics.items()
        }
        begin = time.process_time()
        for topic, _, receipt, data in messages:
            writer.write(connections[topic], receipt, data)
    return (time.process_time() - begin) / len(messages)


def main() -> int:
    """Run, and print; exit code 2 if something was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="of real time")
    options = parser.parse_args()
    load, steal = os.getloadavg()[0], stolen()
    with TemporaryDirectory(prefix="bench_record_") as name:
        folder = Path(name)
        cpu, took = run_graph(folder, options.seconds)
        steal = (stolen() - steal) / took
        with open_bags(folder / "bag") as bags:
            counts = Counter({name: topic.messages for name, topic in bags.topics.items()})
            missing, seconds = lost(bags), sorted(links_rates(bags))
            alone = write_alone(bags, folder / "alone")
        size = sum(file.stat().st_size for file in (folder / "bag").rglob("*.mcap"))
        said = json.loads((folder / "count.log").read_text().splitlines()[-1])
        others, early = map(Counter, said)
    print(f"{os.cpu_count()} cores, load {load:.1f} before, {steal:.2f} stolen; {took:.0f} s")
    print(f"each link by the second, asked {SPEED * RATE:.0f}/s: mean {fmean(seconds):.0f}/s, "
          f"half above {median(seconds):.0f}/s, slowest {seconds[0]:.0f}/s")  # fmt: skip
    count, counted = counts.total(), others.total()
    print(f"{count} messages ({count / took:.0f}/s, {size / 1e6:.0f} MB), {counted} counted")
    print(f"counted since the first /clock, not recorded: {dict(others - early - counts)}; "
          f"recorded, not counted: {dict(counts - others)}")  # fmt: skip
    most = counts.most_common(8)
    print("most: " + ", ".join(f"{topic} {number / took:.0f}/s" for topic, number in most))
    print(f"missing: {sum(missing.values())} {missing}")
    ours, bare = cpu["record"] / count, cpu["count"] / counted
    print(f"processor time a message: record {1e6 * ours:.1f} us, bare raw subscription "
          f"{1e6 * bare:.1f} us, rosbags' writer alone {1e6 * alone:.1f} us")  # fmt: skip
    print(f"ratio to the bare subscription {ours / bare:.2f}; to it and the writer together "
          f"{ours / (bare + alone):.2f}")  # fmt: skip
    print("share of a core: " + ", ".join(f"{k} {v / took:.2f}" for k, v in cpu.items()))
    return 2 if any(missing.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
