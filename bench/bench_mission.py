"""The capture by nodes alone, on the simulated test bed with its default errors.

    . scripts/env.sh; python bench/bench_mission.py --runs 20    # of the grid of bench_capture.py
    python bench/bench_mission.py --runs 280 --out bench/missions.jsonl  # goes on where it ended
    python bench/bench_mission.py --kill                         # each node, in each phase, SIGKILL
    python bench/bench_mission.py --faults                       # each fault, in each phase

Each run is a graph of its own; --part 1 2 and --part 2 2 fly beside each other. With --kill it
prints when the last valve was open and the last joint moving after the kill, and the least gaps of
bodies, gripper and target aside, and to the edge in the time after it; with --faults how the
mission ended, and these gaps until a while after its end. Exits with 1 if bodies touched, or if
what was killed left a valve open for longer than --shut.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from itertools import islice, product
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test/support"))
from running import OWN  # enters a ROS domain of its own: before rclpy

import rclpy  # isort: skip
from rclpy.action import ActionClient  # isort: skip
from rclpy.parameter import Parameter  # isort: skip
from flight import Flyer, start  # isort: skip
from bench_capture import PHASES, grid  # isort: skip
from capturing import POSTURE, SETTINGS, Case  # isort: skip

from rcl_interfaces.srv import SetParameters

from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import SimTruth
from fss_arm_ros.convert import stamp_ns
from fss_rehearsal.processes import Nodes

NODES = "navigation", "control", "guidance", "base", "arm", "links"
#: Whose death leaves nobody who may open a valve on purpose.
LAST = "navigation", "control", "guidance", "base"
INTO = {"approach": 2.0, "reach": 0.5, "grip": 0.0, "detumble": 1.0}  # the phase, at the kill [s]
MEETING = "gripper, target"
BLIND = {f"{subject}.dropout": 1.0 for subject in ("fss", "end_effector", "target")}
#: Parameters of the test bed, and for how long they are so [s].
FAULTS = {
    "no poses for 1 s": (BLIND, 1.0),
    "no poses for 3 s": (BLIND, 3.0),
    "no poses for 10 s": (BLIND, 10.0),
    "a valve open for good": ({"valve_3.stuck_open": 1.0}, np.inf),
    "a valve closed for good": ({"valve_3.stuck_closed": 1.0}, np.inf),
    "gyro lost": ({"fog.dropout": 1.0}, np.inf),
    "a link lost": ({"link_2.dead": 1.0}, np.inf),
}
STILL = 0.02  # of a joint [rad/s]
AFTER = 30.0  # for which it is looked at what comes of a kill [s]
Flown = tuple[list[str], dict[str, float], bool]  # a row's cells, `least`, whether it is as meant
TARGET = {"target_mass": SETTINGS.target_mass, "target_inertia": SETTINGS.target_inertia}


def testbed(case: Case) -> dict[str, object]:
    """The parameters that begin a case."""
    at = case.distance * np.exp(1j * np.radians(-135.0))
    return {
        "base": [float(at.real), float(at.imag), -1.4],
        "q": list(POSTURE),
        "target_pose": [0.0, 0.0, case.heading],
        "target_twist": [*case.drift, case.spin],
        "telemetry_rate": 20.0,
        "seed": case.seed,
        **TARGET,
    }


class Run:
    """One mission on one graph."""

    def __init__(self, nodes: Nodes, case: Case, speed: float) -> None:
        self.nodes = nodes
        known = dict.fromkeys(("navigation", "control"), TARGET)
        guidance = {**TARGET, "posture": list(POSTURE)}
        start(nodes, speed, testbed=testbed(case), guidance=guidance, **known)
        self.flyer = Flyer(nodes, print)
        self.capture = ActionClient(self.flyer, Capture, "mission/capture")
        self.setter = self.flyer.create_client(SetParameters, "testbed/set_parameters")
        self.result: Capture.Result | None = None

    def begin(self) -> None:
        """Arm all, and ask for the capture."""
        flyer = self.flyer
        flyer.begin()
        flyer.until(self.capture.server_is_ready, why="mission/capture")
        handle = flyer.after(self.capture.send_goal_async(Capture.Goal(detumble=True)))
        self.answer = handle.get_result_async()

    def end(self, timeout: float = 900.0) -> Capture.Result:
        """Its result; within real time [s]."""
        return self.flyer.after(self.answer, timeout).result

    def enter(self, phase: str) -> float:
        """Fly into a phase; when that is [s]."""
        flyer = self.flyer
        states = flyer.states
        flyer.until(
            lambda: self.answer.done() or (states and states[-1].phase == phase), 600.0, phase
        )
        if self.answer.done():
            raise TimeoutError(f"the mission ended before {phase}: {self.answer.result().result}")
        flyer.pass_time(INTO[phase])
        return flyer.t

    def kill(self, name: str, phase: str) -> dict[str, float]:
        """Kill a node in a phase; what came of it."""
        since = self.enter(phase)
        self.nodes.processes[name].kill()
        self.flyer.pass_time(AFTER, timeout=600.0)
        rows = self.rows(since)
        times = np.array([1e-9 * stamp_ns(t.header.stamp) - since for t in rows])
        is_open = np.array([any(t.valves) for t in rows])
        moving = np.array([np.abs(t.qd[3:]).max() > STILL for t in rows])
        return {
            "shut": float(times[is_open].max(initial=0.0)),
            "still": float(times[moving].max(initial=0.0)),
            **least(rows),
        }

    def fail(self, parameters: dict[str, float], lasts: float, phase: str) -> dict[str, float]:
        """Have a fault in a phase; what came of it."""
        since = self.enter(phase)
        self.set(parameters)
        if np.isfinite(lasts):
            self.flyer.pass_time(lasts)
            self.set(dict.fromkeys(parameters, 0.0))
        self.result = self.end()
        self.flyer.pass_time(AFTER, timeout=600.0)
        return least(self.rows(since))

    def set(self, parameters: dict[str, float]) -> None:
        """Set parameters of the test bed."""
        given = [
            Parameter(name, value=value).to_parameter_msg() for name, value in parameters.items()
        ]
        answer = self.flyer.after(self.setter.call_async(SetParameters.Request(parameters=given)))
        assert all(each.successful for each in answer.results), answer

    def rows(self, since: float) -> list[SimTruth]:
        """What happened since a time [s]."""
        return [t for t in self.flyer.truths if 1e-9 * stamp_ns(t.header.stamp) >= since]

    def close(self) -> None:
        """Let go."""
        self.capture.destroy()
        self.flyer.close()


def apart(truth: SimTruth) -> float:
    """Least gap of bodies but gripper and target, which are to meet [m]."""
    pairs = zip(truth.pairs, truth.gaps, strict=True)
    return min((gap for pair, gap in pairs if pair != MEETING), default=np.inf)


def least(rows: list[SimTruth]) -> dict[str, float]:
    """Least gaps in them [m], and whether the target is held in the end."""
    return {
        "apart": min(map(apart, rows)),
        "edge": min(t.edge_clearance for t in rows),
        "holds": float(rows[-1].holds),
    }


def faults(logs: Path, given: argparse.Namespace) -> bool:
    """The table of faults; whether all is safe."""

    def fly(run: Run, phase: str, fault: str) -> Flown:
        gaps = run.fail(*FAULTS[fault], phase)
        ended = "captured and stopped" if run.result.stopped else f"aborted: {run.result.message}"
        return [ended], gaps, True

    print("| phase | fault | mission | least gap of bodies [m] | to the edge [m] | holds |")
    print("|---|---|---|---:|---:|---|")
    return table(logs, given, [each for each in FAULTS if (given.fault or "") in each], fly)


def kills(logs: Path, given: argparse.Namespace) -> bool:
    """The table of kills; whether all is safe."""

    def fly(run: Run, phase: str, node: str) -> Flown:
        r = run.kill(node, phase)
        in_time = r["shut"] < given.shut or node not in LAST
        return [f"{r['shut']:.2f}", f"{r['still']:.2f}"], r, in_time

    print("| phase | killed | last valve shut [s] | joints at rest [s] | least gap of bodies [m] "
          "| to the edge [m] | holds |")  # fmt: skip
    print("|---|---|---:|---:|---:|---:|---|")
    return table(logs, given, given.nodes, fly)


def table(
    logs: Path, given: argparse.Namespace, names: Iterable[str], fly: Callable[..., Flown]
) -> bool:
    """Print a row for each phase and name, flown on a graph of its own; whether all is safe."""
    safe = True
    for phase, name in product(given.phases, names):
        with Nodes(logs / f"{phase}_{name.replace(' ', '_')}", print, OWN) as nodes:
            run = Run(nodes, Case(), given.speed)
            try:
                run.begin()
                cells, gaps, fine = fly(run, phase, name)
                holds = "yes" if gaps["holds"] else "no"
                cells += [f"{gaps['apart']:.3f}", f"{gaps['edge']:.2f}", holds]
                fine &= min(gaps["apart"], gaps["edge"]) > 0.0
                verdict = "" if fine else " UNSAFE"
            except (TimeoutError, AssertionError) as error:
                cells, verdict = [str(error)], " NOT FLOWN"
            finally:
                run.close()
        print(f"| {' | '.join([phase, name, *cells])} |{verdict}", flush=True)
        safe &= not verdict
    return safe


def missions(logs: Path, given: argparse.Namespace) -> bool:
    """Runs of the grid; whether all ended without contact."""
    rows = []
    head = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=Path(__file__).parent, capture_output=True,
        text=True,
    )  # fmt: skip
    commit = head.stdout.strip()
    if given.out and given.out.exists():
        rows = [json.loads(line) for line in given.out.read_text().splitlines()]
    flown = [row["case"] for row in rows]
    part, parts = given.part
    for k, case in islice(enumerate(grid()), part - 1, given.runs, parts):
        if (name := f"{case.spin:+.2f}, heading {case.heading:.2f}, seed {case.seed}") in flown:
            continue
        with Nodes(logs / str(k), print, OWN) as nodes:
            run = Run(nodes, case, given.speed)
            try:
                run.begin()
                result = run.end()
                run.flyer.pass_time(1.0)
                truths = run.flyer.truths[::5]
                least = min(min(t.edge_clearance, apart(t)) for t in truths)
            finally:
                run.close()
        rows.append(
            {"case": name, "commit": commit, "spin": abs(case.spin), "stopped": result.stopped,
             "least": least, "ended": f"{result.phase}: {result.message}", "time": result.duration,
             "propellant": 1e3 * result.propellant, "torque": result.largest_torque}
        )  # fmt: skip
        print(f"{k + 1:3}: {rows[-1]}", flush=True)
        if given.out:
            with given.out.open("a") as file:
                print(json.dumps(rows[-1]), file=file)
    print("| spin [rad/s] | runs | captured and stopped | time [s] | propellant [g] "
          "| torque [N m] | least gap [m] |")  # fmt: skip
    print("|---:|---:|---:|---:|---:|---:|---:|")
    for spin in sorted({row["spin"] for row in rows}):
        some = [row for row in rows if row["spin"] == spin]
        good = [row for row in some if row["stopped"]]
        cells = [f"{spin:.2f}", str(len(some)), f"{len(good)}"]
        for name in ("time", "propellant"):
            values = [row[name] for row in good] or [np.nan]
            cells.append(f"{np.median(values):.0f} (to {max(values):.0f})")
        cells.append(f"{max((row['torque'] for row in good), default=np.nan):.2f}")
        cells.append(f"{min(row['least'] for row in some):.3f}")
        print("| " + " | ".join(cells) + " |")
    return all(row["least"] > 0.0 for row in rows)


def main() -> int:
    """Fly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--out", type=Path, help="JSON lines; what is there is not flown again")
    parser.add_argument("--part", type=int, nargs=2, default=(1, 1), metavar=("K", "N"))
    parser.add_argument("--kill", action="store_true")
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--fault", help="with --faults: those in whose names this is")
    parser.add_argument("--phases", nargs="+", default=PHASES, choices=PHASES)
    parser.add_argument("--nodes", nargs="+", default=NODES, choices=NODES)
    parser.add_argument("--shut", type=float, default=1.5, help="valves shut after a kill [s]")
    parser.add_argument("--speed", type=float, default=1.0, help="in multiples of real time")
    given = parser.parse_args()
    rclpy.init()
    logs = Path(mkdtemp(prefix="bench_mission_"))
    fly = kills if given.kill else faults if given.faults else missions
    return int(not fly(logs, given))


if __name__ == "__main__":
    sys.exit(main())
