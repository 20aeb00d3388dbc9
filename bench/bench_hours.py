"""Memory growth of processes and integrity of bags over hours of operation.

Test bed, drivers of four links, arm, both calibrations, base reaction, view and recorder run at a
multiple of real time, while the arm moves almost continuously. The memory of a process is its RSS
minus pages shared with files; its growth counts from the end of the first simulated hour.
"""

import argparse
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any

import numpy as np
import rclpy
from bench_graph import LINKS, MODULES, Graph
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from fss_arm_bags.doctor.health import findings, streams
from fss_arm_bags.inspection import is_sound
from fss_arm_bags.reader import find_bags, open_bags
from fss_arm_msgs.action import MoveArm

MODULES |= {
    "dynamic": "fss_arm_calib.calibration_node:dynamic",
    "arm": "fss_arm_driver.arm_node",
    "reaction": "fss_arm_view.base_reaction_node",
    "view": "fss_arm_view.view_node",
}
PAGE = os.sysconf("SC_PAGE_SIZE")
REST_DURATION = Duration(seconds=6)
VIEWER_MEMORY = "5MB"  # of data that the viewer keeps; reached early in the first hour
MAX_GROWTH = 0.05  # relative, after the first hour


class Operator(Node):
    """Arms the links and moves the arm from posture to posture, with a rest after each fourth."""

    def __init__(self) -> None:
        super().__init__("operator", parameter_overrides=[Parameter("use_sim_time", value=True)])
        self.random = np.random.default_rng(1)
        self.pause = self.create_client(SetBool, "sim/pause")
        self.arm = self.create_client(SetBool, "arm/enable")
        self.charge = self.create_client(Trigger, "sim/charge")
        self.mover = ActionClient(self, MoveArm, "arm/move")
        self.moves = 0
        self.spinner = SingleThreadedExecutor()
        self.spinner.add_node(self)
        self.thread = Thread(target=self.spinner.spin, daemon=True)
        self.thread.start()

    def hours(self) -> float:
        """Return the simulated time [h]."""
        return float(self.get_clock().now().nanoseconds / 3.6e12)

    def wait(self, future: Future, seconds: float) -> Any:
        """Return the result of a future; None after the timeout [s]."""
        done = Event()
        future.add_done_callback(lambda _: done.set())
        return future.result() if done.wait(seconds) else None

    def close(self) -> None:
        """Stop the thread."""
        self.spinner.shutdown()
        self.thread.join()
        self.destroy_node()

    async def request_move(self, goal: MoveArm.Goal) -> Any:
        """Request a move and return its result; None if it is rejected."""
        handle = await self.mover.send_goal_async(goal)
        return await handle.get_result_async() if handle.accepted else None

    def move(self) -> None:
        """Make one move; rest after every fourth; if it fails, arm again."""
        goal = MoveArm.Goal(q=self.random.uniform(-1.4, 1.4, LINKS).tolist())
        # In the executor's thread: rclpy fails if the response arrives during the request.
        answer = self.wait(self.spinner.create_task(self.request_move(goal)), 70.0)
        if answer and answer.result.reached:
            self.moves += 1
            if self.moves % 4 == 0:
                self.get_clock().sleep_for(REST_DURATION)
        else:
            self.wait(self.arm.call_async(SetBool.Request(data=True)), 10.0)


def memory_usage(graph: Graph) -> dict[str, float]:
    """Return the memory of each process, including the viewer that the view starts [MB]."""
    pids = {name: process.pid for name, process in graph.processes.items()}
    children = Path(f"/proc/{pids['view']}/task/{pids['view']}/children").read_text()
    if not children:
        raise RuntimeError("the viewer has exited")
    pids["viewer"] = int(children.split()[0])
    usage = {}
    for name, pid in pids.items():
        _, resident, shared, *_ = Path(f"/proc/{pid}/statm").read_text().split()
        if resident == "0":
            log = (graph.folder / f"{name}.log").read_text()
            raise RuntimeError(f"{name} has exited:\n{log[-2000:]}")
        usage[name] = (int(resident) - int(shared)) * PAGE / 1e6
    return usage


def operate(graph: Graph, hours: float) -> tuple[dict[str, float], dict[str, float], int]:
    """Operate for simulated hours; return memory after the first and last [MB], and the moves."""
    operator = Operator()
    operator.pause.wait_for_service(60.0)
    operator.mover.wait_for_server(60.0)
    deadline = time.monotonic() + 60.0
    while "view" not in operator.get_node_names():
        if time.monotonic() > deadline:
            raise RuntimeError(f"the view does not start within 60 s, see {graph.folder}")
        time.sleep(0.1)
    operator.wait(operator.pause.call_async(SetBool.Request(data=False)), 10.0)
    moves = -1  # at the previous row
    first: dict[str, float] = {}
    usage: dict[str, float] = {}  # minimum of a quarter of an hour, without temporary memory
    start, reported = time.monotonic(), 0.0
    print(" hours   took " + " ".join(f"{name:>9}" for name in memory_usage(graph)) + "  [MB]")
    while rclpy.ok() and (now := operator.hours()) < hours:
        operator.move()
        usage = {name: min(mb, usage.get(name, mb)) for name, mb in memory_usage(graph).items()}
        if now >= reported:
            if operator.moves == moves:
                raise RuntimeError(f"no move succeeds any longer, see {graph.folder}/arm.log")
            moves = operator.moves
            operator.wait(operator.charge.call_async(Trigger.Request()), 10.0)
            elapsed = (time.monotonic() - start) / 3600
            print(f"{now:6.2f} {elapsed:6.2f} " + " ".join(f"{mb:9.1f}" for mb in usage.values())
                  + f"  {operator.moves} moves", flush=True)  # fmt: skip
            if reported > 1.0 and not first:  # the first minimum after the first hour
                first = usage
            last, usage, reported = usage, {}, reported + 0.25
    if not rclpy.ok():
        raise SystemExit(f"interrupted after {operator.hours():.2f} hours")
    operator.wait(operator.pause.call_async(SetBool.Request(data=True)), 10.0)
    operator.close()
    return first or last, last, operator.moves


def main() -> int:
    """Run and print; exit code 2 if a process grew or a bag is damaged."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=8.0, help="simulated time [h]")
    parser.add_argument("--speed", type=float, default=10.0, help="multiple of real time")
    options = parser.parse_args()
    with TemporaryDirectory(prefix="bench_hours_") as name:
        folder = Path(name)
        graph = Graph(options.speed, folder, 1, 5.0)
        graph.start("dynamic", use_sim_time=True)
        graph.start("arm", use_sim_time=True, time_to_live=options.speed)
        graph.start("reaction", use_sim_time=True)
        port, web_port = graph.domain.ports(2)  # of TCP
        graph.start("view", port=port, web_port=web_port, memory=VIEWER_MEMORY, use_sim_time=True)
        rclpy.init()
        try:
            first, last, moves = operate(graph, options.hours)
        finally:
            graph.stop()
            rclpy.try_shutdown()
        growth = {name: last[name] / first[name] - 1.0 for name in first}
        print("growth after the first hour: "
              + ", ".join(f"{name} {100 * g:+.1f}%" for name, g in growth.items()))  # fmt: skip
        bags = find_bags(folder / "bag")
        all_sound = all(map(is_sound, bags))
        with open_bags(folder / "bag") as bags_read:
            topic_streams = streams(bags_read)
            count = sum(topic.messages for topic in bags_read.topics.values())
            for topic, info in bags_read.topics.items():
                for finding in findings(info, topic_streams[topic], bags_read.span[0]):
                    print(f"{topic}: {finding}")
        print(f"{moves} moves; {len(bags)} bags, {'all' if all_sound else 'NOT all'} intact, "
              f"{count} messages")  # fmt: skip
    return 0 if all_sound and max(growth.values()) <= MAX_GROWTH else 2


if __name__ == "__main__":
    sys.exit(main())
