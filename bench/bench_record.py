"""Cost and completeness of recording all topics, with 500 frames per second from each link.

Drivers and test bed run at five times real time with 100 simulated frames per second and link: 500
per second on the wire and on topics, and the same for VICON, FOG and /clock. The recorder runs as
usual and flushes twice a second. For comparison, a node with raw subscriptions to the same topics
only counts messages. Then rosbags' writer alone writes the same messages from memory.
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
from fss_sim.testbed_node import FRAMES_PER_CLOCK

SPEED, RATE = 5.0, 100.0
STEADY = [*VICON, "/fog/imu"]  # a message each frame
os.environ["PYTHONPATH"] = f"{Path(__file__).parent}:{os.environ.get('PYTHONPATH', '')}"
MODULES |= {"count": "raw_counter", "arm": "fss_arm_driver.arm_node"}


def run_graph(folder: Path, seconds: float) -> tuple[dict[str, float], float]:
    """Run for a time [s]; return the processor time of each process and the real time [s]."""
    graph = Graph(SPEED, folder, LINKS, RATE)
    graph.start("arm", use_sim_time=True)
    graph.start("count", use_sim_time=True)
    rclpy.init()
    operator = rclpy.create_node("operator")
    pause = operator.create_client(SetBool, "sim/pause")

    def set_pause(data: bool) -> None:
        done = pause.call_async(SetBool.Request(data=data))
        rclpy.spin_until_future_complete(operator, done)

    try:
        deadline = time.monotonic() + 60.0
        while operator.count_subscribers(TELEMETRY[-1]) < 3:  # recorder, counter, arm
            if time.monotonic() > deadline:
                raise RuntimeError(f"the graph does not start within 60 s, see {folder}")
            time.sleep(0.1)
        pause.wait_for_service(30.0)
        time.sleep(2.0)
        set_pause(False)
        before, start = graph.cpu(), time.monotonic()
        time.sleep(seconds)
        after, elapsed = graph.cpu(), time.monotonic() - start
        set_pause(True)
        time.sleep(3.0)  # for late messages
    finally:
        graph.stop()
        operator.destroy_node()
        rclpy.try_shutdown()
    return {name: after[name] - before[name] for name in after}, elapsed


def missing_messages(bags: Bags) -> dict[str, int]:
    """Return the missing messages by topic, from the drivers' counters and the stamps.

    Frames that are lost on the wire, or that a driver rejects, are not counted.
    """
    published: Counter[str] = Counter()
    missed: Counter[str] = Counter()
    for _, _, _, message in bags.messages({"/diagnostics"}):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "accepted" in values:
                published[f"{status.name}/telemetry"] = int(values["accepted"])
                missed[status.name] = int(values.get("missed", 0))
    print("missed by the drivers, on the wire:", missed.total())
    if unreported := set(TELEMETRY) - set(published):
        raise RuntimeError(f"no diagnostics of {', '.join(sorted(unreported))}")
    published["/joint_states"] = published.total()
    missing = {
        topic: max(0, number - bags.topics[topic].messages) for topic, number in published.items()
    }
    stamps: dict[str, list[int]] = {topic: [] for topic in STEADY}
    for topic, _, _, message in bags.messages(set(STEADY)):
        stamps[topic].append(stamp_ns(message.header.stamp) // FRAME)
    missing |= {topic: n[-1] - n[0] + 1 - len(n) for topic, n in stamps.items()}
    clock = [stamp_ns(message.clock) // FRAME for *_, message in bags.messages({"/clock"})]
    missing["/clock"] = sum((b - a - 1) // FRAMES_PER_CLOCK for a, b in pairwise(clock))  # at least
    return missing


def link_rates(bags: Bags) -> list[float]:
    """Return the telemetry rate of a link in each real second, from the test bed's status [1/s]."""
    rates = []
    for _, _, _, message in bags.messages({"/diagnostics"}):
        for status in message.status:
            if status.name == "/testbed" and not status.message.startswith("paused"):
                values = {pair.key: pair.value for pair in status.values}
                rates.append(RATE * float(values["speed"]))
    return rates[1:-1]  # whole seconds


def stolen_time() -> float:
    """Return the time that the host took from this virtual machine [s]."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


def write_alone(bags: Bags, path: Path) -> float:
    """Return the time of rosbags' writer per message [s], from memory."""
    messages = list(islice(bags.raw(), 300_000))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            name: writer.add_connection(
                name, topic.msgtype, msgdef=topic.definition, rihs01=topic.hash
            )
            for name, topic in bags.topics.items()
        }
        start = time.process_time()
        for topic, _, receipt, data in messages:
            writer.write(connections[topic], receipt, data)
    return (time.process_time() - start) / len(messages)


def main() -> int:
    """Run and print; exit code 2 if messages are missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="of real time")
    options = parser.parse_args()
    load, steal = os.getloadavg()[0], stolen_time()
    with TemporaryDirectory(prefix="bench_record_") as name:
        folder = Path(name)
        cpu, elapsed = run_graph(folder, options.seconds)
        steal = (stolen_time() - steal) / elapsed
        with open_bags(folder / "bag") as bags:
            counts = Counter({name: topic.messages for name, topic in bags.topics.items()})
            missing, seconds = missing_messages(bags), sorted(link_rates(bags))
            writer_time = write_alone(bags, folder / "alone")
        size = sum(file.stat().st_size for file in (folder / "bag").rglob("*.mcap"))
        printed = json.loads((folder / "count.log").read_text().splitlines()[-1])
        counted_by_topic, before_clock = map(Counter, printed)
    print(f"{os.cpu_count()} cores, load {load:.1f} before, {steal:.2f} stolen; {elapsed:.0f} s")
    print(f"frames per link and second, nominal {SPEED * RATE:.0f}/s: mean {fmean(seconds):.0f}/s, "
          f"median {median(seconds):.0f}/s, smallest {seconds[0]:.0f}/s")  # fmt: skip
    count, counted = counts.total(), counted_by_topic.total()
    print(f"{count} messages ({count / elapsed:.0f}/s, {size / 1e6:.0f} MB), {counted} counted")
    unrecorded = dict(counted_by_topic - before_clock - counts)
    print(f"counted since the first /clock, not recorded: {unrecorded}; "
          f"recorded, not counted: {dict(counts - counted_by_topic)}")  # fmt: skip
    most_frequent = counts.most_common(8)
    print(
        "most frequent: "
        + ", ".join(f"{topic} {number / elapsed:.0f}/s" for topic, number in most_frequent)
    )
    print(f"missing: {sum(missing.values())} {missing}")
    ours, bare = cpu["record"] / count, cpu["count"] / counted
    print(f"processor time per message: record {1e6 * ours:.1f} us, bare raw subscription "
          f"{1e6 * bare:.1f} us, rosbags' writer alone {1e6 * writer_time:.1f} us")  # fmt: skip
    print(f"ratio to the bare subscription {ours / bare:.2f}; to it and the writer together "
          f"{ours / (bare + writer_time):.2f}")  # fmt: skip
    print("share of a core: " + ", ".join(f"{k} {v / elapsed:.2f}" for k, v in cpu.items()))
    return 2 if any(missing.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
