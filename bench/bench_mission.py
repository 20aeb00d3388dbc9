"""Capture missions of all nodes, on the simulated test bed with its default errors.

    . scripts/env.sh; python bench/bench_mission.py --runs 20    # of config/campaigns/captures.yaml
    python bench/bench_mission.py --runs 280 --out bench/missions.jsonl  # resumes where it ended
    python bench/bench_mission.py --spin 0.3 --closing-time 0.3 --force 5 --torque 0.5
    python bench/bench_mission.py --lockstep --speed 5           # as fast as the nodes follow
    python bench/bench_mission.py --kill                         # kill each node in each phase
    python bench/bench_mission.py --faults                       # each fault in each phase

Each run starts a new graph; --part 1 2 and --part 2 2 can run at the same time. With --kill, it
prints when the last valve closed and the last joint stopped after the kill, and the smallest gaps
after it: between bodies, except gripper and target, and to the edge. With --faults, it prints how
the mission ended, and these gaps until shortly after its end. Exits with 1 if bodies touched, or if
a valve stayed open for longer than --shut after a kill.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
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
from capturing import POSTURE, SETTINGS, Case  # isort: skip

from rcl_interfaces.srv import SetParameters

from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import SimTruth
from fss_arm_ros.convert import stamp_ns
from fss_rehearsal.campaign.plan import read_campaign
from fss_rehearsal.capture import add_gripper_options, gripper
from fss_rehearsal.processes import Nodes

CAPTURES = Path(__file__).parents[1] / "config/campaigns/captures.yaml"
PHASES = "approach", "reach", "grip", "detumble"
NODES = "navigation", "control", "guidance", "base", "arm", "links"
#: Nodes without which no node opens a valve.
VALVE_NODES = "navigation", "control", "guidance", "base"
#: Time from the start of a phase to the kill [s].
TIME_IN_PHASE = {"approach": 2.0, "reach": 0.5, "grip": 0.0, "detumble": 1.0}
GRIP_PAIR = "gripper, target"
NO_POSES = {f"{subject}.dropout": 1.0 for subject in ("fss", "end_effector", "target")}
#: Parameters of the test bed, and the duration of the fault [s].
FAULTS = {
    "no poses for 1 s": (NO_POSES, 1.0),
    "no poses for 3 s": (NO_POSES, 3.0),
    "no poses for 10 s": (NO_POSES, 10.0),
    "a valve open for good": ({"valve_3.stuck_open": 1.0}, np.inf),
    "a valve closed for good": ({"valve_3.stuck_closed": 1.0}, np.inf),
    "gyro lost": ({"fog.dropout": 1.0}, np.inf),
    "a link lost": ({"link_2.dead": 1.0}, np.inf),
}
MOVING_RATE = 0.02  # rate above which a joint moves [rad/s]
OBSERVATION_TIME = 30.0  # after a kill or the end of a mission [s]
#: Cells of a row, result of `summarize`, True if as required.
Outcome = tuple[list[str], dict[str, float], bool]
TARGET = {"target_mass": SETTINGS.target_mass, "target_inertia": SETTINGS.target_inertia}


def grid(only_spin: float | None) -> Iterator[Case]:
    """Yield the missions of the campaign of captures, in random order; only those of one |spin|."""
    for run in read_campaign(CAPTURES).in_random_order():
        vx, vy, spin = (run.values[f"testbed.target_twist[{k}]"] for k in range(3))
        if only_spin is not None and not np.isclose(abs(spin), only_spin):
            continue
        distance = float(np.hypot(*run.values["testbed.base"][:2]))
        yield Case(spin, run.values["testbed.target_pose[2]"], distance, run.seed, (vx, vy))


def testbed(case: Case) -> dict[str, object]:
    """Return the initial parameters of a case."""
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
    """One mission of a new graph."""

    def __init__(self, nodes: Nodes, case: Case, options: argparse.Namespace) -> None:
        self.nodes, fingers = nodes, gripper(options)
        gnc_nodes = dict.fromkeys(("navigation", "control"), TARGET)
        guidance = {**TARGET, "posture": list(POSTURE), **fingers}
        bed = {**testbed(case), **fingers, "lockstep": options.lockstep}
        start(nodes, options.speed, testbed=bed, guidance=guidance, **gnc_nodes)
        self.flyer = Flyer(nodes, print)
        self.capture = ActionClient(self.flyer, Capture, "mission/capture")
        self.setter = self.flyer.create_client(SetParameters, "testbed/set_parameters")
        self.result: Capture.Result | None = None

    def start_mission(self) -> None:
        """Arm everything and send the capture goal."""
        flyer = self.flyer
        flyer.begin()
        flyer.until(self.capture.server_is_ready, why="mission/capture")
        handle = flyer.after(self.capture.send_goal_async(Capture.Goal(detumble=True)))
        self.answer = handle.get_result_async()

    def end(self, timeout: float = 900.0) -> Capture.Result:
        """Return the result; the timeout is in real time [s]."""
        return self.flyer.after(self.answer, timeout).result

    def enter(self, phase: str) -> float:
        """Fly until a phase; return the time [s]."""
        flyer = self.flyer
        states = flyer.states
        flyer.until(
            lambda: self.answer.done() or (states and states[-1].phase == phase), 600.0, phase
        )
        if self.answer.done():
            raise TimeoutError(f"the mission ended before {phase}: {self.answer.result().result}")
        flyer.pass_time(TIME_IN_PHASE[phase])
        return flyer.t

    def kill(self, name: str, phase: str) -> dict[str, float]:
        """Kill a node in a phase; return what happened."""
        start_time = self.enter(phase)
        self.nodes.processes[name].kill()
        self.flyer.pass_time(OBSERVATION_TIME, timeout=600.0)
        rows = self.rows(start_time)
        times = np.array([1e-9 * stamp_ns(t.header.stamp) - start_time for t in rows])
        is_open = np.array([any(t.valves) for t in rows])
        moving = np.array([np.abs(t.qd[3:]).max() > MOVING_RATE for t in rows])
        return {
            "shut": float(times[is_open].max(initial=0.0)),
            "still": float(times[moving].max(initial=0.0)),
            **summarize(rows),
        }

    def inject_fault(
        self, parameters: dict[str, float], duration: float, phase: str
    ) -> dict[str, float]:
        """Inject a fault in a phase; return what happened."""
        start_time = self.enter(phase)
        self.set(parameters)
        if np.isfinite(duration):
            self.flyer.pass_time(duration)
            self.set(dict.fromkeys(parameters, 0.0))
        self.result = self.end()
        self.flyer.pass_time(OBSERVATION_TIME, timeout=600.0)
        return summarize(self.rows(start_time))

    def set(self, parameters: dict[str, float]) -> None:
        """Set parameters of the test bed."""
        values = [
            Parameter(name, value=value).to_parameter_msg() for name, value in parameters.items()
        ]
        answer = self.flyer.after(self.setter.call_async(SetParameters.Request(parameters=values)))
        assert all(each.successful for each in answer.results), answer

    def rows(self, start_time: float) -> list[SimTruth]:
        """Return the truths since a time [s]."""
        return [t for t in self.flyer.truths if 1e-9 * stamp_ns(t.header.stamp) >= start_time]

    def close(self) -> None:
        """Destroy action client and node."""
        self.capture.destroy()
        self.flyer.close()


def least_gap(truth: SimTruth) -> float:
    """Return the smallest gap between bodies, except gripper and target [m]."""
    pairs = zip(truth.pairs, truth.gaps, strict=True)
    return min((gap for pair, gap in pairs if pair != GRIP_PAIR), default=np.inf)


def summarize(rows: list[SimTruth]) -> dict[str, float]:
    """Return the smallest gaps [m], and whether the target is held at the end."""
    return {
        "apart": min(map(least_gap, rows)),
        "edge": min(t.edge_clearance for t in rows),
        "holds": float(rows[-1].holds),
    }


def faults(logs: Path, options: argparse.Namespace) -> bool:
    """Print the table of faults; return True if all runs are safe."""

    def fly(run: Run, phase: str, fault: str) -> Outcome:
        gaps = run.inject_fault(*FAULTS[fault], phase)
        ended = "captured and stopped" if run.result.stopped else f"aborted: {run.result.message}"
        return [ended], gaps, True

    print("| phase | fault | mission | smallest gap of bodies [m] | to the edge [m] | holds |")
    print("|---|---|---|---:|---:|---|")
    return table(logs, options, [each for each in FAULTS if (options.fault or "") in each], fly)


def kills(logs: Path, options: argparse.Namespace) -> bool:
    """Print the table of kills; return True if all runs are safe."""

    def fly(run: Run, phase: str, node: str) -> Outcome:
        r = run.kill(node, phase)
        in_time = r["shut"] < options.shut or node not in VALVE_NODES
        return [f"{r['shut']:.2f}", f"{r['still']:.2f}"], r, in_time

    print(
        "| phase | killed | last valve closed [s] | joints at rest [s] | least gap of bodies [m] "
        "| to the edge [m] | holds |"
    )
    print("|---|---|---:|---:|---:|---:|---|")
    return table(logs, options, options.nodes, fly)


def table(
    logs: Path, options: argparse.Namespace, names: Iterable[str], fly: Callable[..., Outcome]
) -> bool:
    """Print a row for each phase and name, each with a new graph; return True if all are safe."""
    all_safe = True
    for phase, name in product(options.phases, names):
        with Nodes(logs / f"{phase}_{name.replace(' ', '_')}", print, OWN) as nodes:
            run = Run(nodes, Case() if options.spin is None else Case(options.spin), options)
            try:
                run.start_mission()
                cells, gaps, safe = fly(run, phase, name)
                holds = "yes" if gaps["holds"] else "no"
                cells += [f"{gaps['apart']:.3f}", f"{gaps['edge']:.2f}", holds]
                safe &= min(gaps["apart"], gaps["edge"]) > 0.0
                verdict = "" if safe else " UNSAFE"
            except (TimeoutError, AssertionError) as error:
                cells, verdict = [str(error)], " NOT FLOWN"
            finally:
                run.close()
        print(f"| {' | '.join([phase, name, *cells])} |{verdict}", flush=True)
        all_safe &= not verdict
    return all_safe


def missions(logs: Path, options: argparse.Namespace) -> bool:
    """Fly runs of the grid; return True if all ended without contact."""
    rows = []
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
    )
    commit = revision.stdout.strip()
    if options.out and options.out.exists():
        rows = [json.loads(line) for line in options.out.read_text().splitlines()]
    flown_cases = [row["case"] for row in rows]
    part, parts = options.part
    for k, case in islice(enumerate(grid(options.spin)), part - 1, options.runs, parts):
        if (
            name := f"{case.spin:+.2f}, heading {case.heading:.2f}, seed {case.seed}"
        ) in flown_cases:
            continue
        with Nodes(logs / str(k), print, OWN) as nodes:
            run = Run(nodes, case, options)
            try:
                run.start_mission()
                result = run.end()
                run.flyer.pass_time(1.0)
                truths = run.flyer.truths[::5]
                least = min(min(t.edge_clearance, least_gap(t)) for t in truths)
            finally:
                run.close()
        rows.append(
            {
                "case": name,
                "commit": commit,
                "spin": abs(case.spin),
                "stopped": result.stopped,
                "least": least,
                "ended": f"{result.phase}: {result.message}",
                "time": result.duration,
                "propellant": 1e3 * result.propellant,
                "torque": result.largest_torque,
            }
        )
        print(f"{k + 1:3}: {rows[-1]}", flush=True)
        if options.out:
            with options.out.open("a") as file:
                print(json.dumps(rows[-1]), file=file)
    print(
        "| spin [rad/s] | runs | captured and stopped | time [s] | propellant [g] "
        "| torque [N m] | smallest gap [m] |"
    )
    print("|---:|---:|---:|---:|---:|---:|---:|")
    for spin in sorted({row["spin"] for row in rows}):
        group = [row for row in rows if row["spin"] == spin]
        good = [row for row in group if row["stopped"]]
        cells = [f"{spin:.2f}", str(len(group)), f"{len(good)}"]
        for name in ("time", "propellant"):
            values = [row[name] for row in good] or [np.nan]
            cells.append(f"{np.median(values):.0f} (to {max(values):.0f})")
        cells.append(f"{max((row['torque'] for row in good), default=np.nan):.2f}")
        cells.append(f"{min(row['least'] for row in group):.3f}")
        print("| " + " | ".join(cells) + " |")
    return all(row["least"] > 0.0 for row in rows)


def main() -> int:
    """Fly the selected runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--out", type=Path, help="JSON lines file; runs in it are not repeated")
    parser.add_argument("--part", type=int, nargs=2, default=(1, 1), metavar=("K", "N"))
    parser.add_argument("--kill", action="store_true")
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--fault", help="with --faults: only faults whose name contains this")
    parser.add_argument("--phases", nargs="+", default=PHASES, choices=PHASES)
    parser.add_argument("--nodes", nargs="+", default=NODES, choices=NODES)
    parser.add_argument(
        "--shut", type=float, default=1.5, help="time limit for closed valves after a kill [s]"
    )
    parser.add_argument("--speed", type=float, default=1.0, help="in multiples of real time")
    parser.add_argument(
        "--lockstep", action="store_true", help="time waits for the nodes; --speed is the largest"
    )
    parser.add_argument(
        "--spin", type=float, help="turn rate of the target, only these runs [rad/s]"
    )
    add_gripper_options(parser)
    options = parser.parse_args()
    rclpy.init()
    logs = Path(mkdtemp(prefix="bench_mission_"))
    fly = kills if options.kill else faults if options.faults else missions
    return int(not fly(logs, options))


if __name__ == "__main__":
    sys.exit(main())
