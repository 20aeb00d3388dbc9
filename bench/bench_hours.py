"""Whether a process grows, and whether bags are whole, over hours of operation in fast time.

Test bed, four links' driver, arm, both calibrations, base reaction, view and recorder at a multiple
of real time, the arm moving nearly all the while. Memory is what a process holds itself (RSS less
what it shares with files), compared from the end of its first simulated hour on.
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
from fss_arm_bags.reader import find, open_bags
from fss_arm_msgs.action import MoveArm

MODULES |= {
    "dynamic": "fss_arm_calib.calibration_node:dynamic",
    "arm": "fss_arm_driver.arm_node",
    "reaction": "fss_arm_view.base_reaction_node",
    "view": "fss_arm_view.view_node",
}
PAGE = os.sysconf("SC_PAGE_SIZE")
REST = Duration(seconds=6)
VIEWED = "5MB"  # that the viewer keeps: full early in the first hour
MOST = 0.05  # growth after the first hour


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
        """Simulated time."""
        return float(self.get_clock().now().nanoseconds / 3.6e12)

    def wait(self, future: Future, seconds: float) -> Any:
        """The answer; None: not in time."""
        over = Event()
        future.add_done_callback(lambda _: over.set())
        return future.result() if over.wait(seconds) else None

    def close(self) -> None:
        """End the thread."""
        self.spinner.shutdown()
        self.thread.join()
        self.destroy_node()

    async def ask(self, goal: MoveArm.Goal) -> Any:
        """The result of a move; None: it was refused."""
        handle = await self.mover.send_goal_async(goal)
        return await handle.get_result_async() if handle.accepted else None

    def move(self) -> None:
        """One move, perhaps a rest; if it fails, arm again."""
        goal = MoveArm.Goal(q=self.random.uniform(-1.4, 1.4, LINKS).tolist())
        # Asked in the spinner's thread: rclpy fails if an answer comes while it is still asking.
        answer = self.wait(self.spinner.create_task(self.ask(goal)), 70.0)
        if answer and answer.result.reached:
            self.moves += 1
            if self.moves % 4 == 0:
                self.get_clock().sleep_for(REST)
        else:
            self.wait(self.arm.call_async(SetBool.Request(data=True)), 10.0)


def memory(graph: Graph) -> dict[str, float]:
    """What each process holds, the viewer that the view starts among them [MB]."""
    pids = {name: process.pid for name, process in graph.processes.items()}
    children = Path(f"/proc/{pids['view']}/task/{pids['view']}/children").read_text()
    if not children:
        raise RuntimeError("the viewer has ended")
    pids["viewer"] = int(children.split()[0])
    held = {}
    for name, pid in pids.items():
        _, resident, shared, *_ = Path(f"/proc/{pid}/statm").read_text().split()
        if resident == "0":
            log = (graph.folder / f"{name}.log").read_text()
            raise RuntimeError(f"{name} has ended:\n{log[-2000:]}")
        held[name] = (int(resident) - int(shared)) * PAGE / 1e6
    return held


def operate(graph: Graph, hours: float) -> tuple[dict[str, float], dict[str, float], int]:
    """Operate for simulated hours; memory after the first and at the end [MB], and the moves."""
    operator = Operator()
    operator.pause.wait_for_service(60.0)
    operator.mover.wait_for_server(60.0)
    deadline = time.monotonic() + 60.0
    while "view" not in operator.get_node_names():
        if time.monotonic() > deadline:
            raise RuntimeError(f"the view does not come up, see {graph.folder}")
        time.sleep(0.1)
    operator.wait(operator.pause.call_async(SetBool.Request(data=False)), 10.0)
    moves = -1  # at the row before
    first: dict[str, float] = {}
    held: dict[str, float] = {}  # the least of a quarter of an hour: without what work takes
    begin, reported = time.monotonic(), 0.0
    print(" hours   took " + " ".join(f"{name:>9}" for name in memory(graph)) + "  [MB]")
    while rclpy.ok() and (now := operator.hours()) < hours:
        operator.move()
        held = {name: min(mb, held.get(name, mb)) for name, mb in memory(graph).items()}
        if now >= reported:
            if operator.moves == moves:
                raise RuntimeError(f"no move is reached any more, see {graph.folder}/arm.log")
            moves = operator.moves
            operator.wait(operator.charge.call_async(Trigger.Request()), 10.0)
            took = (time.monotonic() - begin) / 3600
            print(f"{now:6.2f} {took:6.2f} " + " ".join(f"{mb:9.1f}" for mb in held.values())
                  + f"  {operator.moves} moves", flush=True)  # fmt: skip
            if reported > 1.0 and not first:  # the least from the end of the first hour on
                first = held
            last, held, reported = held, {}, reported + 0.25
    if not rclpy.ok():
        raise SystemExit(f"interrupted after {operator.hours():.2f} hours")
    operator.wait(operator.pause.call_async(SetBool.Request(data=True)), 10.0)
    operator.close()
    return first or last, last, operator.moves


def main() -> int:
    """Run, and print; exit code 2 if a process grew or a bag is not whole."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=8.0, help="simulated")
    parser.add_argument("--speed", type=float, default=10.0, help="multiple of real time")
    options = parser.parse_args()
    with TemporaryDirectory(prefix="bench_hours_") as name:
        folder = Path(name)
        graph = Graph(options.speed, folder, 1, 5.0)
        graph.start("dynamic", use_sim_time=True)
        graph.start("arm", use_sim_time=True, time_to_live=options.speed)
        graph.start("reaction", use_sim_time=True)
        port, web_port = graph.domain.ports(2)  # of TCP
        graph.start("view", port=port, web_port=web_port, memory=VIEWED, use_sim_time=True)
        rclpy.init()
        try:
            first, last, moves = operate(graph, options.hours)
        finally:
            graph.stop()
            rclpy.try_shutdown()
        growth = {name: last[name] / first[name] - 1.0 for name in first}
        print("growth after the first hour: "
              + ", ".join(f"{name} {100 * g:+.1f}%" for name, g in growth.items()))  # fmt: skip
        bags = find(folder / "bag")
        whole = all(map(is_sound, bags))
        with open_bags(folder / "bag") as read:
            heard = streams(read)
            count = sum(topic.messages for topic in read.topics.values())
            for topic, about in read.topics.items():
                for finding in findings(about, heard[topic], read.span[0]):
                    print(f"{topic}: {finding}")
        print(f"{moves} moves; {len(bags)} bags, {'all' if whole else 'NOT all'} whole, "
              f"{count} messages")  # fmt: skip
    return 0 if whole and max(growth.values()) <= MOST else 2


if __name__ == "__main__":
    sys.exit(main())
