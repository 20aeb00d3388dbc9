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
from std_srvs.srv import SetBool, Trigger

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.recompute import recalibrate
from fss_arm_calib.report_parts import with_description
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.description_file import load
from fss_arm_msgs.msg import KinematicCalibration, KinematicObservations
from fss_arm_ros import report
from fss_arm_ros.qos import LATCHED
from fss_rehearsal.domain import CONFIG, Domain
from fss_rehearsal.operators import LINKS, Operator, isolated_domain
from fss_rehearsal.processes import Nodes, short_path
from fss_rehearsal.progress import counting_bar
from fss_rehearsal.rehearsed import Check, Rehearsed

RECORDED_TOPICS = (
    "/joint_states",
    *(f"/link_{i}/telemetry" for i in range(1, LINKS + 1)),
    "/vicon/fss/fss",
    "/vicon/end_effector/end_effector",
)


class Calibrator(Operator):
    """Operator that arms the links, starts the simulated clock and requests the solution."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, parameter_overrides=[Parameter("use_sim_time", value=True)])
        self.time, self.last_check = self.get_clock().now(), time.monotonic()
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

    def published_outcome(self) -> Outcome[Observation, Solution] | None:
        """Return the published result with its observations, or None until both have arrived."""
        if self.result is None:
            return None
        outcome = recalibrate(KINEMATIC, self.result, self.observations)
        origin = self.result.calibration.provenance
        return outcome if outcome.provenance.data_hash == origin.data_hash else None

    def resume_clock(self) -> None:
        """Resume a paused clock, as in a test bed just started, once all topics have subscribers.

        Recorder and calibration then receive the same messages from the start.
        """
        now = self.get_clock().now()
        if now != self.time:
            self.time, self.last_check = now, time.monotonic()
        elif time.monotonic() - self.last_check > 1.0:
            if not all(map(self.has_subscribers, RECORDED_TOPICS)):
                return
            self.call_service(self.pause, SetBool.Request(data=False), 2.0)
            self.last_check = time.monotonic()

    def has_subscribers(self, topic: str) -> bool:
        """Return True if recorder and calibration both subscribe to the topic."""
        names = {info.node_name for info in self.get_subscriptions_info_by_topic(topic)}
        return names >= {"record", "kinematic"}

    def call_service(self, client, request, deadline: float = 10.0):  # type: ignore[no-untyped-def]
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
        "testbed",
        "fss_sim",
        "testbed",
        arm=truth,
        seed=options.seed,
        preset=options.preset,
        ports=nodes.domain.ports(LINKS),
        keep_clock=True,
        speed=options.speed,
        paused=True,
        state_file=out / "testbed.json",
    )
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag", **clock)
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        nodes.start(
            f"link_{i}",
            "fss_arm_driver",
            "link",
            link=i,
            url=url,
            timeout=timeout,
            watchdog=2.0 * timeout,
            **clock,
        )
    nodes.start("arm", "fss_arm_driver", "arm", time_to_live=timeout, **clock)
    nodes.start(
        "kinematic",
        "fss_arm_calib",
        "kinematic",
        arm=guess,
        output=out / "arm.yaml",
        state_file=out / "observations.json",
        **clock,
    )
    nodes.start(
        "experiment",
        "fss_arm_calib",
        "experiment",
        state_file=out / "experiment.json",
        postures=DEFAULT_POSTURES[: options.postures].ravel().tolist(),
        **clock,
    )


def observe(
    options: argparse.Namespace, out: Path, console: Console, domain: Domain
) -> Outcome[Observation, Solution]:
    """Run the experiment, close the last rest; return the result.

    Raises:
        RehearsalError: a node failed, or the deadline passed.
    """
    end_time = time.monotonic() + options.deadline
    with Nodes(out / "logs", console.print, domain) as nodes, counting_bar(console) as bar:
        start_all(nodes, options, out)
        operator = Calibrator(domain)
        task = bar.add_task("postures observed", total=options.postures)
        while not nodes.has_finished("experiment"):
            if time.monotonic() > end_time:
                raise nodes.overdue("experiment", options.deadline)
            nodes.restart_killed()
            rclpy.spin_once(operator, timeout_sec=0.1)
            bar.update(task, completed=operator.done)
            operator.resume_clock()
            operator.keep_armed()
        bar.update(task, completed=options.postures)
        # Results of earlier observations may still arrive.
        while (live := operator.published_outcome()) is None or len(live.used) < options.postures:
            if time.monotonic() > end_time:
                raise nodes.overdue("kinematic", options.deadline)
            nodes.restart_killed()
            operator.call_service(operator.solve, Trigger.Request())
            rclpy.spin_once(operator, timeout_sec=0.5)
        operator.destroy_node()
    return live


def from_bag(bag: Path, live: Outcome[Observation, Solution]) -> Check:
    """Solve again from the bag alone, and compare the result with the live one."""
    expected = "the bag alone gives the same verdict"
    settings = KinematicSettings(arm=str(CONFIG / "cad.yaml"), parametrization="equal")
    offline = solve_bag(KINEMATIC, bag, settings)
    if len(offline.used) != len(live.used):
        # One of the two nodes was killed, and missed messages until it was restarted.
        comparison = f"from {len(offline.used)} rests, {len(live.used)} live"
    else:
        worst = float(abs(offline.values - live.values).max())
        comparison = f"parameters differ by at most {worst:.2g} (m or rad)"
    happened = f"solved again from the bag: {offline.verdict}, {comparison}"
    return Check(expected, happened, offline.verdict == live.verdict)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="multiple of real time (default 1); two cores can reach 2, four 5",
    )
    parser.add_argument(
        "--postures",
        type=int,
        choices=range(7, len(DEFAULT_POSTURES) + 1),  # fewer observations rarely check each other
        default=len(DEFAULT_POSTURES),
        help="number of postures to observe (default %(default)s)",
    )
    parser.add_argument(
        "--preset",
        default="paper",
        help="preset of the simulator: ideal, default, paper (if not given), laboratory",
    )
    parser.add_argument(
        "--deadline", type=float, default=600.0, help="timeout of the experiment [s] (default 600)"
    )


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Run the experiment, and solve again from its bag."""
    with isolated_domain() as domain:
        console.print(f"starting all nodes in their own ROS domain, {domain.number}")
        result = observe(options, out, console, domain)
    found = KINEMATIC.report_of(result, load(CONFIG / "truth.yaml"))
    if (out / "arm.yaml").exists():
        found = with_description(found, short_path(out / "arm.yaml"))
    console.print(report.printable(found, options.details), highlight=False)
    reproduced = from_bag(out / "bag", result)
    console.print(reproduced.happened)
    verdict_check = Check("the calibration passes", result.summary, result.verdict == PASS)
    files = {
        "bag": "recording",
        "arm.yaml": "calibrated arm",
        "report/kinematic_observations.png": "residuals",
        "report/kinematic_postures.png": "postures",
        "logs": "logs of the nodes",
    }
    return Rehearsed([verdict_check, reproduced], reports=[found], files=files)
