"""Design maneuvers, run them in the simulator over UDP, record them and solve for the dynamics.

The simulated arm differs from its description in everything that a laboratory does not know:
centres of mass and inertias of the links differ freely, all other parameters (base, kinematics,
weighed masses) by their standard deviations. The base drifts and the table is tilted, so that the
operator puts the base back after each session of maneuvers.
"""

import argparse
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite, radians
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rich.console import Console

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.experiment.design import design, expected_result
from fss_arm_calib.experiment.planned import Planned, plan_to_yaml, read_plan
from fss_arm_calib.experiment.settings import Conditions
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.description_file import save
from fss_arm_model.parameters import values
from fss_arm_model.units import GRAVITY, SECOND
from fss_arm_ros import report
from fss_arm_ros.convert import stamp_ns
from fss_rehearsal.domain import Domain
from fss_rehearsal.load import Load, overload
from fss_rehearsal.operators import LINKS, Operator, isolated_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.progress import counting_bar
from fss_rehearsal.rehearsed import Check, Rehearsed

MAX_STATUS = 28  # characters of the experiment's status beside the progress bar
PAUSE = 5.2  # between maneuvers [s]
# Maneuvers before the operator puts the base back to the middle of the table.
MANEUVERS_PER_SESSION = 4
TABLE = (3.7, 3.7)  # table size for planning [m]; the margin allows for drift in a session


@dataclass(frozen=True)
class Cameras:
    """Errors with which motion capture measures the base."""

    position: float  # standard deviation [m]
    heading: float  # standard deviation [rad]
    hold: float  # time for which an error stays constant [s]


#: The paper's 1.54 degrees are for a turn, the difference of two headings; its 17.7 mm for a pose.
NOISE = {
    "laboratory": Cameras(0.001, radians(0.5), 0.1),
    "paper": Cameras(0.0177, radians(1.54) / 2**0.5, 2.0),
}


class Experimenter(Operator):
    """Operator that arms the links and follows the experiment's progress."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain)
        self.status_message = "starting"
        self.stops = 0  # stops of the session's maneuvers that were reached
        self.load = Load()
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Store the experiment's status message and progress, and signs of overload."""
        stamp = stamp_ns(message.header.stamp) / SECOND
        for status in message.status:
            self.load.add(status.name, stamp, {pair.key: pair.value for pair in status.values})
            if status.name == "/experiment":
                self.status_message = status.message
                self.stops = int(status.values[0].value)


def draw_truth(guess: Arm, settings: DynamicSettings, seed: int) -> Arm:
    """Return a random arm that is consistent with the guess and its standard deviations."""
    rng, n = np.random.default_rng(seed), guess.n
    v = values(guess) + settings.deviations(guess) * rng.standard_normal(5 * n + 6)
    masses = v[2 * n + 6 : 3 * n + 6]
    b = [link.b for link in guess.links] + rng.uniform(-0.015, 0.015, n)
    inertia = [link.inertia for link in guess.links] * rng.uniform(0.75, 1.25, n)
    arm = guess.with_kinematics(v[4 : 2 * n + 6])
    links = [
        replace(link, mass=float(masses[i]), b=float(b[i]), inertia=float(inertia[i]))
        for i, link in enumerate(arm.links)
    ]
    base = replace(arm.base, mass=float(v[0]), inertia=float(v[1]), com=tuple(v[2:4].tolist()))
    return replace(arm, name="truth", base=base, links=tuple(links))


def plan_file(out: Path, session: int) -> Path:
    """Return the file with the plan of a session, which has index `session`."""
    return out / f"plan_{session + 1}.yaml"


def start_all(
    nodes: Nodes, options: argparse.Namespace, out: Path, cameras: Cameras, session: int
) -> None:
    """Start all nodes for a session, with the base in the middle of the table."""
    rng = np.random.default_rng((options.seed, session))
    twist = (rng.uniform(-1.0, 1.0, 3) * [0.003, 0.003, 0.004]).tolist()
    (first, *_) = read_plan(plan_file(out, session), LINKS)
    nodes.start(
        "testbed",
        "fss_sim",
        "testbed",
        arm=out / "truth.yaml",
        seed=100 * options.seed + session,
        ports=nodes.domain.ports(LINKS),
        preset="laboratory",
        position_noise=cameras.position,
        heading_noise=cameras.heading,
        vicon_hold=cameras.hold,
        twist=twist,
        tilt=[options.tilt, -0.5 * options.tilt],
        base=[0.0, 0.0, rng.uniform(-3.0, 3.0)],
        q=first.waypoints[0].tolist(),
    )
    nodes.start("record", "fss_arm_bags", "record", output=out / "bags")
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        nodes.start(f"link_{i}", "fss_arm_driver", "link", link=i, url=url)
    nodes.start("arm", "fss_arm_driver", "arm")
    nodes.start("dynamic", "fss_arm_calib", "dynamic", **settings_of(out, cameras))
    nodes.start(
        "experiment",
        "fss_arm_calib",
        "experiment",
        maneuvers=plan_file(out, session),
        pause=PAUSE,
    )


def maneuvers_done(plan: Sequence[Planned], stops: int) -> int:
    """Return how many maneuvers are done after `stops` stops; the first is where they start."""
    ends = 1 + np.cumsum([len(one.durations) for one in plan])
    return int(np.searchsorted(ends, stops, side="right"))


def run_sessions(
    options: argparse.Namespace, out: Path, cameras: Cameras, console: Console, domain: Domain
) -> tuple[list[int], list[Load]]:
    """Run all maneuvers, session after session; return the times of the starts [ns] and loads.

    Raises:
        RehearsalError: a node failed, or the deadline passed.
    """
    end_time = time.monotonic() + options.deadline
    count = len(list(out.glob("plan_*.yaml")))
    plans = [read_plan(plan_file(out, session), LINKS) for session in range(count)]
    bar = counting_bar(console)
    task, starts, loads = bar.add_task("maneuvers", total=sum(map(len, plans))), [], []
    for session, plan in enumerate(plans):
        logs, before = out / "logs" / f"session_{session + 1}", sum(map(len, plans[:session]))
        with Nodes(logs, console.print, domain) as nodes, bar:
            starts.append(time.time_ns())
            start_all(nodes, options, out, cameras, session)
            operator = Experimenter(domain)
            loads.append(operator.load)
            while not nodes.has_finished("experiment"):
                if time.monotonic() > end_time:
                    raise nodes.overdue("experiment", options.deadline)
                nodes.restart_killed()
                rclpy.spin_once(operator, timeout_sec=0.1)
                waiting = not operator.status_message.startswith("posture")
                status = waiting * shorten(operator.status_message, MAX_STATUS, placeholder="...")
                bar.update(
                    task,
                    completed=before + maneuvers_done(plan, operator.stops),
                    description=f"maneuvers, session {session + 1} of {count} {status}".rstrip(),
                )
                operator.keep_armed()
            bar.update(
                task,
                completed=before + len(plan),
                description=f"maneuvers, session {session + 1} of {count}",
            )
            operator.destroy_node()
    return starts, loads


def prepare(
    options: argparse.Namespace, out: Path, cameras: Cameras, progress: Callable[[int], None]
) -> tuple[Arm, list[Planned]]:
    """Write guess, truth and plan; return truth and plan; report the number of maneuvers chosen."""
    settings = DynamicSettings(**settings_of(out, cameras))
    guess = paper_arm()
    truth = draw_truth(guess, settings, options.seed)
    save(guess, out / "guess.yaml")
    save(truth, out / "truth.yaml")
    plan = design(
        guess,
        options.count,
        settings,
        Conditions(rest=PAUSE, table=TABLE),
        seed=options.seed,
        chosen=[f"b_{i}" for i in range(1, LINKS + 1)],
        begin=np.array([0.6, -1.0, 1.0, -0.6]),
        tried=500,
        progress=progress,
    )
    for session, first in enumerate(range(0, len(plan), MANEUVERS_PER_SESSION)):
        part = plan[first : first + MANEUVERS_PER_SESSION]
        plan_file(out, session).write_text(plan_to_yaml(part), encoding="utf-8")
    return truth, plan


def settings_of(out: Path, cameras: Cameras) -> dict[str, Any]:
    """Return the settings of the calibration, live and from the bags."""
    return {
        "arm": str(out / "guess.yaml"),
        "position_deviation": cameras.position,
        "heading_deviation": cameras.heading,
        "fresh_rate": 1.0 / cameras.hold,
        "bin": max(0.5, cameras.hold),
    }


def solve_planned(
    out: Path, settings: DynamicSettings, starts: Sequence[int], log_line: Callable[[str], None]
) -> Outcome[Maneuver, Solution]:
    """Solve from as many maneuvers of each session as were planned; gaps make some repeat.

    Args:
        out: folder of the rehearsal.
        settings: of the calibration.
        starts: time of the start of each session [ns].
        log_line: receives a line about the maneuvers used.

    Raises:
        BagError: a bag cannot be read.
    """
    result = solve_bag(DYNAMIC, out / "bags", settings)
    counts, kept = [0] * len(starts), []
    for one in result.data:
        session = max(0, bisect_right(starts, one.start) - 1)
        if one.used and counts[session] == MANEUVERS_PER_SESSION:
            continue
        counts[session] += one.used
        kept.append(one)
    used, surplus = ", ".join(map(str, counts)), len(result.data) - len(kept)
    log_line(
        f"{len(result.data)} motions recorded: {sum(counts)} used as maneuvers ({used} in sessions "
        f"1 to {len(starts)}){f', {surplus} surplus' * (surplus > 0)}"
    )
    for number, one in enumerate(result.data, 1):
        if not one.used:
            log_line(f"  motion {number} rejected: {one.reason}")
    if len(kept) == len(result.data):
        return result
    return calibrate(kept, result.arm, settings, source=result.provenance.source)


def summary(
    result: Outcome[Maneuver, Solution], truth: Arm, plan: list[Planned], predicted: np.ndarray
) -> str:
    """Return a summary of the centres of mass: predicted and estimated deviations, and errors."""
    names = list(result.names)
    lines = []
    for i, link in enumerate(truth.links):
        k = names.index(f"b_{i + 1}")
        before, now, error = 1e3 * np.array(
            [predicted[k], result.deviations[k], result.values[k] - link.b]
        )
        lines.append(
            f"b_{i + 1}: sigma planned {before:.1f} mm, {_in_millimeters(now)}; "
            f"error {error:+.1f} mm"
        )
    largest = 1e3 * max(result.deviations[names.index(f"b_{i}")] for i in range(1, LINKS + 1))
    lines.append(
        f"{len(result.used)} maneuvers of at most {max(p.length for p in plan):.1f} s; "
        f"largest sigma of b_1 to b_{LINKS} {_in_millimeters(largest)}"
    )
    return "\n".join(lines)


def _in_millimeters(deviation: float) -> str:
    return f"obtained {deviation:.1f} mm" if isfinite(deviation) else "not determined"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--noise",
        choices=list(NOISE),
        default="laboratory",
        help="noise of the cameras (default %(default)s)",
    )
    parser.add_argument("--count", type=int, default=16, help="number of maneuvers (default 16)")
    parser.add_argument(
        "--tilt",
        type=float,
        default=radians(0.001),
        help="tilt of the table [rad] (default %(default).3g)",
    )
    parser.add_argument(
        "--deadline", type=float, default=1800.0, help="timeout of all maneuvers [s] (default 1800)"
    )


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Design and run the maneuvers, and solve; one seed for truth, errors and design."""
    out.mkdir(parents=True)
    cameras = NOISE[options.noise]
    with counting_bar(console) as bar:
        task = bar.add_task("designing maneuvers", total=options.count)
        truth, plan = prepare(options, out, cameras, lambda k: bar.update(task, completed=k))
    settings = DynamicSettings(**settings_of(out, cameras))
    predicted = expected_result(paper_arm(), plan, settings, PAUSE).deviations
    with isolated_domain() as domain:
        console.print(
            f"running the maneuvers; all nodes are in their own ROS domain, {domain.number}"
        )
        starts, loads = run_sessions(options, out, cameras, console, domain)
    with console.status("solving from the bags"):
        result = solve_planned(out, settings, starts, partial(console.print, soft_wrap=True))
    checks = [Check("the calibration passes", result.summary, result.verdict == PASS)]
    checks += [center_of_mass_check(result, truth, i) for i in range(LINKS)]
    late = overload(loads)
    if late and not all(check.passed for check in checks):
        console.print(late, style="bold yellow")
    tilt = [GRAVITY * options.tilt, -0.5 * GRAVITY * options.tilt]  # as in start_all
    summary_report = dynamic_report(result, truth, tilt)
    console.print(report.printable(summary_report, options.details), highlight=False)
    console.print(summary(result, truth, plan, predicted))
    files = {"bags": "recordings", "logs": "logs of the nodes"}
    return Rehearsed(checks, reports=[summary_report], files=files, invalid=late)


def center_of_mass_check(result: Outcome[Maneuver, Solution], truth: Arm, i: int) -> Check:
    """Compare the centre of mass of link i + 1 with the truth."""
    k = list(result.names).index(f"b_{i + 1}")
    error, deviation = float(result.values[k] - truth.links[i].b), float(result.deviations[k])
    return Check(
        f"the error of b_{i + 1} is below three standard deviations",
        f"{1e3 * error:+.1f} mm, {abs(error) / deviation:.1f} standard deviations"
        if isfinite(deviation)
        else "not determined",
        isfinite(deviation) and abs(error) < 3.0 * deviation,
    )
