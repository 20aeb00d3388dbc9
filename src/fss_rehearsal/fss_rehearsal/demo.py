"""Run the kinematic calibration on a simulated test bed and show its result.

The program takes the role of the operator in the laboratory: it starts the nodes, arms the links,
restarts nodes that died, closes the experiment, and solves again from the bag to compare.
"""

import argparse
import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from std_srvs.srv import SetBool, Trigger

from fss_arm_calib import report
from fss_arm_calib.acceptance import PASS
from fss_arm_calib.experiment.postures import DEFAULT
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.recompute import again
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.description_file import load
from fss_arm_msgs.msg import KinematicCalibration, KinematicObservations
from fss_arm_ros.qos import LATCHED
from fss_rehearsal.domain import CONFIG, Domain
from fss_rehearsal.person import LINKS, Operator, own_domain
from fss_rehearsal.processes import Nodes, RehearsalError
from fss_rehearsal.rehearsed import Check, Rehearsed

LISTENED = (
    "/joint_states",
    *(f"/link_{i}/telemetry" for i in range(1, LINKS + 1)),
    "/vicon/fss/fss",
    "/vicon/end_effector/end_effector",
)


class Calibrator(Operator):
    """Operator that arms the links, starts the simulated clock and requests the solution."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, parameter_overrides=[Parameter("use_sim_time", value=True)])
        self.time, self.checked = self.get_clock().now(), time.monotonic()
        self.done = 0  # postures observed
        self.result: KinematicCalibration | None = None
        self.observations = KinematicObservations()
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)
        self.create_subscription(
            KinematicCalibration, "calibration/kinematic", self.on_result, LATCHED
        )
        self.create_subscription(
            KinematicObservations, "calibration/observations", self.on_observations, LATCHED
        )
        self.pause = self.create_client(SetBool, "sim/pause")
        self.solve = self.create_client(Trigger, "kinematic/solve")

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Store the experiment's progress: the number of postures observed."""
        for status in message.status:
            if status.name == "/experiment":
                self.done = int(status.values[0].value)

    def on_result(self, message: KinematicCalibration) -> None:
        """Store the newest result."""
        self.result = message

    def on_observations(self, message: KinematicObservations) -> None:
        """Store the observations of the newest result."""
        self.observations = message

    def live(self) -> Outcome[Observation, Solution] | None:
        """Return the published result with its observations, or None until both have arrived."""
        if self.result is None:
            return None
        outcome = again(KINEMATIC, self.result, self.observations)
        origin = self.result.calibration.provenance
        return outcome if outcome.provenance.data_hash == origin.data_hash else None

    def let_time_go(self) -> None:
        """Resume a paused clock, as in a test bed just started, once all topics have subscribers.

        Recorder and calibration then receive the same messages from the start.
        """
        now = self.get_clock().now()
        if now != self.time:
            self.time, self.checked = now, time.monotonic()
        elif time.monotonic() - self.checked > 1.0 and all(map(self.listened, LISTENED)):
            self.service(self.pause, SetBool.Request(data=False), 2.0)
            self.checked = time.monotonic()

    def listened(self, topic: str) -> bool:
        """Return True if recorder and calibration both subscribe to the topic."""
        names = {info.node_name for info in self.get_subscriptions_info_by_topic(topic)}
        return names >= {"record", "kinematic"}

    def service(self, client, request, deadline: float = 10.0):  # type: ignore[no-untyped-def]
        """Call a service; return its response, or None if it is not ready or times out."""
        if not client.service_is_ready():
            return None
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self, future, timeout_sec=deadline)
        return future.result() if future.done() else None


def start_all(nodes: Nodes, options: argparse.Namespace, out: Path) -> None:
    """Start all nodes."""
    truth, guess = CONFIG / "truth.yaml", CONFIG / "cad.yaml"
    clock = {"use_sim_time": True}
    # Processes need real time to respond: at higher speed, that is more simulated time.
    timeout = max(1.0, options.speed)
    nodes.start(
        "testbed", "fss_sim", "testbed", arm=truth, seed=options.seed, preset=options.preset,
        ports=nodes.domain.ports(LINKS), keep_clock=True, speed=options.speed, paused=True,
        state_file=out / "testbed.json",
    )  # fmt: skip
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag", **clock)
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        nodes.start(
            f"link_{i}", "fss_arm_driver", "link", link=i, url=url, timeout=timeout,
            watchdog=2.0 * timeout, **clock,
        )  # fmt: skip
    nodes.start("arm", "fss_arm_driver", "arm", time_to_live=timeout, **clock)
    nodes.start(
        "kinematic", "fss_arm_calib", "kinematic", arm=guess, output=out / "arm.yaml",
        state_file=out / "observations.json", **clock,
    )  # fmt: skip
    nodes.start(
        "experiment", "fss_arm_calib", "experiment", state_file=out / "experiment.json",
        postures=DEFAULT[: options.postures].ravel().tolist(), **clock,
    )  # fmt: skip


def observe(
    options: argparse.Namespace, out: Path, console: Console, domain: Domain
) -> Outcome[Observation, Solution]:
    """Run the experiment, close the last rest; return the result.

    Raises:
        RehearsalError: a node failed, or the deadline passed.
    """
    give_up = time.monotonic() + options.deadline
    with Nodes(out / "logs", console.print, domain) as nodes, progress(console) as bar:
        start_all(nodes, options, out)
        operator = Calibrator(domain)
        task = bar.add_task("postures observed", total=options.postures)
        while not nodes.ended("experiment"):
            if time.monotonic() > give_up:
                raise RehearsalError(f"not done after {options.deadline:.0f} s, see {nodes.logs}")
            nodes.restart_dead()
            rclpy.spin_once(operator, timeout_sec=0.1)
            bar.update(task, completed=operator.done)
            operator.let_time_go()
            operator.keep_armed()
        bar.update(task, completed=options.postures)
        # Results of earlier observations may still arrive.
        while (live := operator.live()) is None or len(live.used) < options.postures:
            if time.monotonic() > give_up:
                raise RehearsalError(f"no solution: {nodes.last_words('kinematic')}")
            nodes.restart_dead()
            operator.service(operator.solve, Trigger.Request())
            rclpy.spin_once(operator, timeout_sec=0.5)
        operator.destroy_node()
    return live


def progress(console: Console) -> Progress:
    """Return a progress bar that counts postures."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    )


def from_bag(bag: Path, live: Outcome[Observation, Solution]) -> Check:
    """Solve again from the bag alone, and compare the result with the live one."""
    expected = "the bag alone gives the verdict, too"
    settings = KinematicSettings(arm=str(CONFIG / "cad.yaml"), parametrization="equal")
    offline = solve_bag(KINEMATIC, bag, settings)
    if len(offline.used) != len(live.used):
        # One of the two nodes was killed, and missed messages until it was restarted.
        told = f"from {len(offline.used)} rests in it, {len(live.used)} seen live"
    else:
        worst = float(abs(offline.values - live.values).max())
        told = f"parameters differ by at most {worst:.1e}"
    happened = f"solved again from the bag: {offline.verdict}, {told}"
    return Check(expected, happened, offline.verdict == live.verdict)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="multiple of real time; two cores keep up with 2, four with 5",
    )
    parser.add_argument(
        "--postures",
        type=int,
        choices=range(7, len(DEFAULT) + 1),  # fewer observations rarely check each other
        default=len(DEFAULT),
        help="to observe: the first so many",
    )
    parser.add_argument(
        "--preset", default="paper", help="of the simulator: ideal, default, paper, laboratory"
    )
    parser.add_argument("--deadline", type=float, default=600.0, help="give up after [s]")


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Run the experiment, and solve again from its bag."""
    with own_domain() as domain:
        console.print(
            f"starting simulator, {LINKS} drivers over UDP, recorder and calibration, "
            f"in ROS domain {domain.number}",
            soft_wrap=True,
        )
        result = observe(options, out, console, domain)
    found = KINEMATIC.report_of(result, load(CONFIG / "truth.yaml"))
    console.print(report.printed(found))
    again = from_bag(out / "bag", result)
    console.print(again.happened)
    passes = Check("the calibration passes", result.reason, result.verdict == PASS)
    files = {
        "bag": "recording",
        "arm.yaml": "calibrated description",
        "report/kinematic_observations.png": "residuals",
        "report/kinematic_postures.png": "postures",
        "logs": "of the nodes",
    }
    return Rehearsed([passes, again], reports=[found], files=files)
