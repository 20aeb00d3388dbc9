"""Soak of the whole graph in real time: a mission every ten minutes, one random fault in each.

    . scripts/env.sh; python bench/soak.py --hours 8

A mission arms everything, takes the base to a random pose and moves the arm there. Meanwhile a node
is killed or stopped, a cable is cut, the clock is set back, the disk is full or a flood arrives. A
mission may end by its fault, but it must end, and the next one must be possible. Between missions
no valve opens and no joint moves. The recorder loses nothing unless the disk is full. No process
grows by more than 2 % after its first hour.

Prints a line for each mission. Exits with 0 if the hours were reached and all of this held, with 2
if not, with 1 after an error and with 130 or 143 if it was interrupted; the summary always follows.
"""

import argparse
import resource
import signal
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from fss_arm_msgs.action import GoToPose, MoveArm
from fss_arm_msgs.msg import MissionState, SimTruth
from fss_arm_msgs.srv import ResetTestbed
from fss_arm_ros.qos import SENSOR
from fss_rehearsal.capture import POSTURE, CaptureOperator
from fss_rehearsal.domain import CONFIG, Domain
from fss_rehearsal.operators import LINKS, isolated_domain
from fss_rehearsal.processes import Nodes, rehearse, results

HOUR = 3600.0  # [s]
MAX_GROWTH = 0.02  # of a process's memory after its first hour
SETTLING_TIME = 5.0  # from the end of a mission until nothing moves any more [s]
MISSION_TIMEOUT = 300.0  # [s]
MOVING_RATE = 0.02  # of a joint [rad/s]
FAULT_DURATION = 4.0  # of a cut cable, a full disk, a stopped node and a flood [s]
FLOOD_RATE = 1000.0  # of poses and datagrams [1/s]
POSES = "vicon/fss/fss"
POSE_RANGE = 0.3  # of random poses about the table's centre [m]
ANGLE_RANGE = 0.2  # of random angles about a compact posture [rad]
TANK_VOLUME = 0.02  # of a tank that lasts for all hours [m^3]
#: Nodes with the package of each; the test bed has no fault.
PACKAGES = {
    "record": "fss_arm_bags", "links": "fss_arm_driver", "arm": "fss_arm_driver",
    "base": "fss_base_driver", "navigation": "fss_gnc", "control": "fss_gnc",
    "guidance": "fss_gnc", "motion": "fss_arm_motion", "kinematic": "fss_arm_calib",
    "dynamic": "fss_arm_calib",
}  # fmt: skip


class SoakOperator(CaptureOperator):
    """Operator that flies missions, and watches what moves between them."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain)
        self.go_to = ActionClient(self, GoToPose, "base/go_to")
        self.move = ActionClient(self, MoveArm, "arm/move")
        self.reset = self.create_client(ResetTestbed, "sim/reset")
        self.charge = self.create_client(Trigger, "sim/charge")
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, SENSOR)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 100)
        self.flying, self.unasked, self.lost = False, 0, 0

    def on_state(self, message: MissionState) -> None:
        """Print nothing: the line of a mission has its result."""

    def on_truth(self, message: SimTruth) -> None:
        """Count states in which something moves between missions."""
        moves = any(message.valves) or max(map(abs, message.qd[3:])) > MOVING_RATE
        self.unasked += moves and not self.flying

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Store how many messages the recorder has lost."""
        for status in message.status:
            if status.name == "/record":
                self.lost = next(int(v.value) for v in status.values if v.key == "lost")

    def pause(self, seconds: float) -> None:
        """Spin for a time [s], in real time."""
        end = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > end, "never", seconds + 10.0)

    def call(self, client: Any, request: Any) -> None:
        """Call a service of the test bed."""
        self.wait(client.service_is_ready, f"no service {client.srv_name}")
        self.result_of(client.call_async(request), f"{client.srv_name} does not respond")

    def fly(self, rng: Random, inject: Callable[[], str], delay: float) -> tuple[str, str]:
        """Fly a mission; return the fault injected `delay` [s] after its start, and how it ended.

        Raises:
            RehearsalError: it does not end.
        """
        pose = [rng.uniform(-POSE_RANGE, POSE_RANGE) for _ in range(2)]
        q = [angle + rng.uniform(-ANGLE_RANGE, ANGLE_RANGE) for angle in POSTURE]
        goals: dict[str, tuple[ActionClient, Any]] = {
            "guidance": (self.go_to, GoToPose.Goal(pose=[*pose, rng.uniform(-3.0, 3.0)])),
            "arm": (self.move, MoveArm.Goal(q=q)),
        }
        self.flying, answers = True, {}
        for name, (client, goal) in goals.items():
            self.wait(client.server_is_ready, f"no node {name}")
            handle = self.result_of(client.send_goal_async(goal), f"node {name} does not answer")
            answers[name] = handle.get_result_async()
        self.pause(delay)
        fault = inject()
        answers.pop(fault.removeprefix("killed "), None)  # its result is lost
        self.wait(
            lambda: all(answer.done() for answer in answers.values()),
            f"the mission does not end after: {fault}",
            MISSION_TIMEOUT,
        )
        results = {name: answer.result().result for name, answer in answers.items()}
        self.pause(SETTLING_TIME)
        self.flying = False
        return fault, "; ".join(
            f"{name} {'reached' if result.reached else result.message}"
            for name, result in results.items()
        )


def start_all(nodes: Nodes, out: Path, seed: int) -> None:
    """Start all nodes on the test bed's time, which is real time; links send at their own 5 Hz."""
    clock, ports = {"use_sim_time": True}, nodes.domain.ports(2 * LINKS + 2)
    board, driver = ports[2 * LINKS :]
    nodes.start(
        "testbed", "fss_sim", "testbed", ports=ports[:LINKS], board_port=board, keep_clock=True,
        speed=1.0, seed=seed, truth_rate=20.0, tank_volume=TANK_VOLUME, q=POSTURE,
    )  # fmt: skip
    patient = {"timeout": 2.0, "watchdog": 2.0}
    parameters: dict[str, dict[str, object]] = {
        "record": {"output": out / "bag"},
        "links": {"urls": nodes.domain.urls(LINKS), **patient},
        "base": {"url": f"udp://127.0.0.1:{board}?bind={driver}", **patient},
        "kinematic": {"arm": CONFIG / "cad.yaml"},
        "dynamic": {"arm": CONFIG / "arm.yaml"},
    }
    for name, package in PACKAGES.items():
        executable = "link" if name == "links" else name
        nodes.start(name, package, executable, **clock, **parameters.get(name, {}))


class Faults:
    """Faults of one graph; each ends before its call returns.

    Args:
        nodes: of the graph.
        operator: of the graph.
        rng: that chooses nodes and links.
    """

    def __init__(self, nodes: Nodes, operator: SoakOperator, rng: Random) -> None:
        self.nodes, self.operator, self.rng = nodes, operator, rng
        self.waiting: list[Callable[[], str]] = []  # before any kind is repeated
        self.kinds = (
            self.kill,
            self.stop,
            self.cut_cable,
            self.set_clock,
            self.fill_disk,
            self.flood,
        )

    def next(self) -> Callable[[], str]:
        """Return the next fault: each kind once, in random order, then again."""
        if not self.waiting:
            self.waiting = self.rng.sample(self.kinds, len(self.kinds))
        return self.waiting.pop()

    def kill(self) -> str:
        """Kill a node, and start it again."""
        name = self.rng.choice(list(PACKAGES))
        self.nodes.starts[name] = 0
        self.nodes.processes[name].kill()
        self.nodes.processes[name].wait()
        self.operator.pause(1.0)
        self.nodes.restart_killed()
        return f"killed {name}"

    def stop(self) -> str:
        """Stop a node for a while."""
        name = self.rng.choice(list(PACKAGES))
        self.nodes.processes[name].send_signal(signal.SIGSTOP)
        self.operator.pause(FAULT_DURATION)
        self.nodes.processes[name].send_signal(signal.SIGCONT)
        return f"stopped {name}"

    def cut_cable(self) -> str:
        """Cut the cable of a link or of the board for a while."""
        part = self.rng.choice([*(f"link_{i}" for i in range(1, LINKS + 1)), "board"])
        self.operator.set_faults({f"{part}.loss": 1.0})
        self.operator.pause(FAULT_DURATION)
        self.operator.set_faults({f"{part}.loss": 0.0})
        return f"cut the cable of {part}"

    def set_clock(self) -> str:
        """Set the clock back to its start, with the test bed."""
        self.operator.call(self.operator.reset, ResetTestbed.Request(seed=-1))
        return "set the clock back"

    def fill_disk(self) -> str:
        """Let the recorder's files not grow for a while."""
        pid, unlimited = self.nodes.processes["record"].pid, resource.RLIM_INFINITY
        _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, unlimited))
        self.operator.pause(FAULT_DURATION)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
        return "filled the disk"

    def flood(self) -> str:
        """Publish invalid poses, and send noise to the drivers of all links."""
        ports = self.nodes.domain.ports(2 * LINKS)[LINKS:]
        pose, poses = PoseStamped(), self.operator.create_publisher(PoseStamped, POSES, SENSOR)
        pose.pose.position.x = float("nan")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
            for _ in range(round(FAULT_DURATION * FLOOD_RATE)):
                poses.publish(pose)
                for port in ports:
                    noise.sendto(self.rng.randbytes(72), ("127.0.0.1", port))
                self.operator.pause(1.0 / FLOOD_RATE)
        self.operator.destroy_publisher(poses)
        return "flooded poses and drivers"


def resident(pid: int) -> float:
    """Return the memory of a process [MB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


class MemoryWatch:
    """Memory of each process since its first hour."""

    def __init__(self) -> None:
        self.first_seen: dict[int, float] = {}
        self.reference: dict[int, float] = {}  # after the first hour [MB]
        self.growth: dict[str, tuple[float, float]] = {}  # of each process alive: then, now [MB]

    def measure(self, nodes: Nodes) -> float:
        """Measure all processes; return their sum [MB]."""
        now, total = time.monotonic(), 0.0
        self.growth.clear()
        for name, process in nodes.processes.items():
            memory = resident(process.pid)
            total += memory
            if now - self.first_seen.setdefault(process.pid, now) >= HOUR:
                then = self.reference.setdefault(process.pid, memory)
                self.growth[name] = then, memory
        return total

    def worst(self) -> tuple[float, str]:
        """Return the largest growth, and the process."""
        shares = ((now / then - 1.0, name) for name, (then, now) in self.growth.items())
        return max(shares, default=(0.0, "none is older than an hour"))


class Tally:
    """What happened so far."""

    def __init__(self) -> None:
        self.start, self.missions, self.reached = time.monotonic(), 0, 0
        self.faults: Counter[str] = Counter()
        self.failures: list[str] = []
        self.memory = MemoryWatch()

    @property
    def hours(self) -> float:
        """Hours since the start."""
        return (time.monotonic() - self.start) / HOUR

    @contextmanager
    def summary(self) -> Iterator[None]:
        """Print the summary at the end, whatever ends it."""
        try:
            yield
        except BaseException as error:
            self.failures.append(f"ended before its time: {error or type(error).__name__}")
            raise
        finally:
            growth, name = self.memory.worst()
            kinds = ", ".join(f"{kind} {count}" for kind, count in sorted(self.faults.items()))
            print(
                f"{self.hours:.2f} h, {self.missions} missions, {self.reached} reached both goals"
            )
            print(f"faults survived: {sum(self.faults.values())} ({kinds})")
            print(f"largest growth of memory after an hour: {100.0 * growth:.1f} % ({name})")
            print(*(self.failures or ["nothing lost, nothing moved unasked"]), sep="\n", flush=True)


def fly_mission(nodes: Nodes, operator: SoakOperator, faults: Faults, tally: Tally) -> None:
    """Fly a mission with one fault, and print what happened."""
    rng, lost = faults.rng, operator.lost
    inject = faults.next()
    operator.call(operator.charge, Trigger.Request())
    operator.arm_all()
    fault, ended = operator.fly(rng, inject, rng.uniform(1.0, 15.0))
    tally.missions += 1
    tally.reached += ended.count("reached") == 2
    tally.faults[inject.__name__] += 1
    if operator.lost > lost and inject != faults.fill_disk:
        tally.failures.append(f"mission {tally.missions}: {operator.lost - lost} messages lost")
    total = tally.memory.measure(nodes)
    line = f"{tally.hours:6.2f} h  mission {tally.missions}: {fault}; {ended}; {total:.0f} MB"
    print(line, flush=True)


def soak(options: argparse.Namespace) -> int:
    """Fly missions for the hours given; return the exit code."""
    out = results(options.out, "soak")
    rng, tally = Random(options.seed), Tally()
    with isolated_domain() as domain, Nodes(out / "logs", print, domain) as nodes:
        print(f"recording and logs: {out}; ROS domain {domain.number}", flush=True)
        start_all(nodes, out, options.seed)
        operator = SoakOperator(domain)
        faults = Faults(nodes, operator, rng)
        with tally.summary():
            while tally.hours < options.hours:
                due = time.monotonic() + options.period
                fly_mission(nodes, operator, faults, tally)
                operator.pause(max(0.0, due - time.monotonic()))
                nodes.restart_killed()
                if operator.unasked:
                    text = f"mission {tally.missions}: moved unasked in {operator.unasked} states"
                    tally.failures.append(text)
                    operator.unasked = 0
            tally.memory.measure(nodes)
            if tally.memory.worst()[0] > MAX_GROWTH:
                tally.failures.append("memory grew by more than 2 % after the first hour")
    return 2 if tally.failures else 0


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--period", type=float, default=600.0, help="of missions [s]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for recording and logs")
    options = parser.parse_args()
    return rehearse("soak", partial(soak, options))


if __name__ == "__main__":
    sys.exit(main())
