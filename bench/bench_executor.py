"""Compare ways to receive messages: rclpy's executors, and this workspace's subscription set.

The receiver has the entities of a typical node here: two topics of PoseStamped and one of Imu at
100 Hz each, ten topics on which nothing is published, five publishers and a timer of 100 Hz.

- plain: SingleThreadedExecutor, messages converted by rclpy;
- bytes: SingleThreadedExecutor, raw subscriptions, converted in the callback;
- set: SingleThreadedExecutor, `fss_arm_ros.subscription_set`, as every node here;
- events, events bytes: rclpy.experimental.EventsExecutor (of 7.1.6, it handles no message).

Prints processor share, lost messages and latency from publishing to callback. Exits with 1 if the
set loses a message or takes more of a core than `plain`.
"""

import argparse
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import Imu

from fss_arm_ros.convert import stamp_ns, to_time
from fss_arm_ros.qos import SENSOR, sensor
from fss_arm_ros.subscription_set import relax_events, subscribe_bytes

TOPICS = {"base": PoseStamped, "target": PoseStamped, "gyro": Imu}
METHODS = ("plain", "bytes", "set", "events", "events bytes")
RATE = 100  # [Hz]
IDLE, OUTPUTS = 10, 5  # topics without a publisher; publishers of the receiver


class Receiver(Node):
    """Receives the topics in one of METHODS, and records how late each message is [ns]."""

    def __init__(self, method: str) -> None:
        super().__init__(f"receiver_{METHODS.index(method)}")
        self.ages: list[int] = []
        self.ticks = 0
        idle = {f"idle_{i}": PoseStamped for i in range(IDLE)}
        for topic, kind in {**TOPICS, **idle}.items():
            if method == "set":
                subscribe_bytes(self, kind, topic, self.reader(kind), sensor())
            elif method.endswith("bytes"):
                self.create_subscription(kind, topic, self.reader(kind), sensor(), raw=True)
            else:
                self.create_subscription(kind, topic, self.on_message, sensor())
        for i in range(OUTPUTS):
            self.create_publisher(PoseStamped, f"output_{i}", SENSOR)
        self.create_timer(1.0 / RATE, self.on_tick)
        if method == "set":
            relax_events(self)

    def reader(self, kind: type) -> Callable[[bytes], None]:
        """Return a callback that converts bytes to a message."""
        return lambda data: self.on_message(deserialize_message(data, kind))

    def on_message(self, message: Any) -> None:
        """Record the age of a message."""
        self.ages.append(time.time_ns() - stamp_ns(message.header.stamp))

    def on_tick(self) -> None:
        """Count a tick of the timer."""
        self.ticks += 1


def receive(method: str) -> None:
    """Receive until terminated, then print the processor time [s], ages [ns] and ticks as JSON."""
    if method.startswith("events"):
        from rclpy.experimental import EventsExecutor as Executor
    else:
        Executor = SingleThreadedExecutor
    rclpy.init()
    node, executor = Receiver(method), Executor()
    executor.add_node(node)
    # An executor that ignores signals, as that of 7.1.6, is ended by its own handler.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    start = time.process_time()
    try:
        with suppress(ExternalShutdownException, KeyboardInterrupt, SystemExit):
            executor.spin()
    finally:
        processor_time = time.process_time() - start
        print(
            json.dumps({"processor_time": processor_time, "ages": node.ages, "ticks": node.ticks}),
            flush=True,
        )


def publish(seconds: float) -> int:
    """Publish for a time [s]; return the number of messages."""
    node = Node("source")
    outputs = {topic: node.create_publisher(kind, topic, SENSOR) for topic, kind in TOPICS.items()}
    messages = {topic: kind() for topic, kind in TOPICS.items()}
    deadline = time.monotonic() + 20.0
    while any(p.get_subscription_count() == 0 for p in outputs.values()):
        if time.monotonic() > deadline:
            raise TimeoutError("no receiver subscribes")
        time.sleep(0.05)
    count, due = round(seconds * RATE), time.monotonic() + 1.0
    for _ in range(count):
        time.sleep(max(0.0, due - time.monotonic()))
        due += 1.0 / RATE
        for topic, message in messages.items():
            message.header.stamp = to_time(time.time_ns())
            outputs[topic].publish(message)
    time.sleep(0.5)  # for the last ones
    node.destroy_node()
    return count * len(TOPICS)


def measure(method: str, seconds: float) -> tuple[float, int, float, float, int]:
    """Return share of a core [%], messages lost, latency p50 and p99 [ms], ticks of the timer."""
    process = subprocess.Popen(
        [sys.executable, __file__, "--receive", method], stdout=subprocess.PIPE, text=True
    )
    try:
        sent = publish(seconds)
        process.terminate()
        try:
            output, _ = process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            return np.nan, sent, np.nan, np.nan, 0
    finally:
        process.kill()
    result = json.loads(output or '{"processor_time": NaN, "ages": [], "ticks": 0}')
    ages = 1e-6 * np.array(result["ages"] or [np.nan])
    p50, p99 = np.percentile(ages, (50, 99))
    share = 100.0 * result["processor_time"] / (seconds + 1.5)
    return share, sent - len(result["ages"]), float(p50), float(p99), result["ticks"]


def main() -> int:
    """Measure each method in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--receive", choices=METHODS, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.receive:
        receive(given.receive)
        return 0
    rclpy.init()
    table = Table(*("way", "core [%]", "lost", "p50 [ms]", "p99 [ms]", "ticks"))
    result = {method: measure(method, given.seconds) for method in METHODS}
    for method, (share, lost, p50, p99, ticks) in result.items():
        table.add_row(method, f"{share:.1f}", str(lost), f"{p50:.2f}", f"{p99:.2f}", str(ticks))
    Console(width=80).print(table)
    plain, own = result["plain"], result["set"]
    print(f"set takes {own[0] / plain[0]:.2f} times the processor time of plain")
    return 0 if own[1] == 0 and own[0] < plain[0] else 1


if __name__ == "__main__":
    sys.exit(main())
