"""Run the main job on a simulated test bed and show its result.

Stands for the person in the laboratory: starts the nodes, arms the links, starts again what
died, closes the experiment, reads the bag back and compares.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import TracebackType

import rclpy
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
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
from fss_arm_model import description
from fss_arm_msgs.msg import KinematicCalibration, KinematicObservations, LinkTelemetry
from fss_arm_ros.qos import LATCHED, SENSOR

CONFIG = Path(__file__).resolve().parent.parent / "config"
LINKS = 4
LISTENED = (
    "/joint_states",
    *(f"/link_{i}/telemetry" for i in range(1, LINKS + 1)),
    "/vicon/fss/fss",
    "/vicon/end_effector/end_effector",
)
STARTS_AT_MOST = 5  # of one node; a node that dies more often has a fault of its own


class DemoError(RuntimeError):
    """The demo cannot go on; the message says why and where to look."""


class Nodes:
    """The node processes, each with its log; stops them all on leaving."""

    def __init__(self, logs: Path, say: Callable[[str], None]) -> None:
        self.logs = logs
        self.say = say
        self.commands: dict[str, list[str]] = {}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.starts: dict[str, int] = {}
        logs.mkdir(parents=True)

    def start(self, name: str, package: str, executable: str, **parameters: object) -> None:
        """Start `executable` as `ros2 run` does, under the name `name`."""
        path = Path(get_package_prefix(package), "lib", package, executable)
        command = [str(path), "--ros-args"]
        for key, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else value
            command += ["-p", f"{key}:={text}"]
        self.commands[name] = command
        self._start(name)

    def _start(self, name: str) -> None:
        self.starts[name] = self.starts.get(name, 0) + 1
        with (self.logs / f"{name}.log").open("ab") as log:
            # A session of its own: Ctrl-C is for this script, which then stops them in order.
            self.processes[name] = subprocess.Popen(
                self.commands[name],
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    def restart_dead(self) -> None:
        """Start again each node that was killed; one that gave up by itself ends the demo.

        Raises:
            DemoError: a node ended with an error of its own, or was killed too often.
        """
        for name, process in self.processes.items():
            code = process.poll()
            if code is None or code == 0:
                continue
            if code > 0 or self.starts[name] >= STARTS_AT_MOST:
                raise DemoError(f"node {name} ended with {code}: {self.last_words(name)}")
            self.say(f"node {name} was killed ({signal.Signals(-code).name}), starting it again")
            self._start(name)

    def last_words(self, name: str) -> str:
        """The last line of the node's log, and where the rest is."""
        log = self.logs / f"{name}.log"
        lines = log.read_text(errors="replace").splitlines() or ["(nothing said)"]
        return f"{lines[-1]} (see {log})"

    def ended(self, name: str) -> bool:
        """Whether the node has finished its work."""
        return self.processes[name].poll() == 0

    def stop(self, name: str, patience: float = 10.0) -> None:
        """Interrupt one node and wait until it is gone."""
        process = self.processes.pop(name)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            self.say(f"node {name} does not stop, killing it")
            process.kill()
            process.wait()

    def __enter__(self) -> "Nodes":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for name in reversed(list(self.processes)):
            self.stop(name)


class Operator(Node):
    """What the person does: looks at the links, arms them, asks for the solution."""

    def __init__(self) -> None:
        super().__init__("operator", parameter_overrides=[Parameter("use_sim_time", value=True)])
        self.time, self.looked = self.get_clock().now(), time.monotonic()
        self.armed = dict.fromkeys(range(1, LINKS + 1), False)
        self.done = 0  # postures
        self.result: KinematicCalibration | None = None
        self.observations = KinematicObservations()
        for i in self.armed:
            self.create_subscription(LinkTelemetry, f"link_{i}/telemetry", self.on_link, SENSOR)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)
        self.create_subscription(
            KinematicCalibration, "calibration/kinematic", self.on_result, LATCHED
        )
        self.create_subscription(
            KinematicObservations, "calibration/observations", self.on_observations, LATCHED
        )
        self.pause = self.create_client(SetBool, "sim/pause")
        self.arm = self.create_client(SetBool, "arm/arm")
        self.solve = self.create_client(Trigger, "kinematic/solve")

    def on_link(self, message: LinkTelemetry) -> None:
        """Whether the link is armed."""
        self.armed[message.link] = message.armed

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """How far the experiment is."""
        for status in message.status:
            if status.name == "experiment":
                self.done = int(status.values[0].value)

    def on_result(self, message: KinematicCalibration) -> None:
        """The newest result."""
        self.result = message

    def on_observations(self, message: KinematicObservations) -> None:
        """What the newest result is from."""
        self.observations = message

    def live(self) -> Outcome[Observation, Solution] | None:
        """The result with what it is from, as published; None: one of both is still on its way."""
        if self.result is None:
            return None
        outcome = again(KINEMATIC, self.result, self.observations)
        origin = self.result.calibration.provenance
        return outcome if outcome.provenance.data_hash == origin.data_hash else None

    def let_time_go(self) -> None:
        """If time stands still, as in a test bed just started, end that once all are listened to.

        Recorder and calibration then see the same from the first moment on.
        """
        now = self.get_clock().now()
        if now != self.time:
            self.time, self.looked = now, time.monotonic()
        elif time.monotonic() - self.looked > 1.0 and all(map(self.listened, LISTENED)):
            self.service(self.pause, SetBool.Request(data=False), 2.0)
            self.looked = time.monotonic()

    def listened(self, topic: str) -> bool:
        """Whether recorder and calibration both hear the topic."""
        names = {info.node_name for info in self.get_subscriptions_info_by_topic(topic)}
        return names >= {"record", "kinematic"}

    def service(self, client, request, deadline: float = 10.0):  # type: ignore[no-untyped-def]
        """The service's answer, or None when it does not answer in time."""
        if not client.service_is_ready():
            return None
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self, future, timeout_sec=deadline)
        return future.result() if future.done() else None


def start_all(nodes: Nodes, options: argparse.Namespace, out: Path) -> None:
    """Start the whole graph."""
    truth, guess = CONFIG / "truth.yaml", CONFIG / "cad.yaml"
    clock = {"use_sim_time": True}
    # Processes take their real time: at higher speed, that is more of the clock's.
    patience = max(1.0, options.speed)
    ports = free_ports(2 * LINKS)
    nodes.start(
        "testbed", "fss_sim", "testbed", arm=truth, seed=options.seed, preset=options.preset,
        ports=ports[:LINKS], keep_clock=True, speed=options.speed, paused=True,
        state_file=out / "testbed.json",
    )  # fmt: skip
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag", **clock)
    for i in range(1, LINKS + 1):
        url = f"udp://127.0.0.1:{ports[i - 1]}?bind={ports[LINKS + i - 1]}"
        nodes.start(
            f"link_{i}", "fss_arm_driver", "link", link=i, url=url, timeout=patience,
            watchdog=2.0 * patience, **clock,
        )  # fmt: skip
    nodes.start("arm", "fss_arm_driver", "arm", time_to_live=patience, **clock)
    nodes.start(
        "kinematic", "fss_arm_calib", "kinematic", arm=guess, output=out / "arm.yaml",
        state_file=out / "observations.json", **clock,
    )  # fmt: skip
    nodes.start(
        "experiment", "fss_arm_calib", "experiment", state_file=out / "experiment.json",
        postures=DEFAULT[: options.postures].ravel().tolist(), **clock,
    )  # fmt: skip


def run(options: argparse.Namespace, out: Path, console: Console) -> Outcome[Observation, Solution]:
    """See the experiment through, close the last rest; return the result.

    Raises:
        DemoError: a node gave up, or it took too long.
    """
    give_up = time.monotonic() + options.deadline
    with Nodes(out / "logs", console.print) as nodes, progress(console) as bar:
        start_all(nodes, options, out)
        operator = Operator()
        task = bar.add_task("postures observed", total=options.postures)
        while not nodes.ended("experiment"):
            if time.monotonic() > give_up:
                raise DemoError(f"not done after {options.deadline:.0f} s, see {nodes.logs}")
            nodes.restart_dead()
            rclpy.spin_once(operator, timeout_sec=0.1)
            bar.update(task, completed=operator.done)
            operator.let_time_go()
            if not all(operator.armed.values()):
                operator.service(operator.arm, SetBool.Request(data=True), 2.0)
        bar.update(task, completed=options.postures)
        # Results of earlier observations may still be on their way.
        while (live := operator.live()) is None or len(live.used) < options.postures:
            if time.monotonic() > give_up:
                raise DemoError(f"no solution: {nodes.last_words('kinematic')}")
            nodes.restart_dead()
            operator.service(operator.solve, Trigger.Request())
            rclpy.spin_once(operator, timeout_sec=0.5)
        operator.destroy_node()
    return live


def progress(console: Console) -> Progress:
    """A bar that counts postures."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    )


def free_ports(count: int) -> list[int]:
    """UDP ports of the loopback that nobody has at this moment."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for s in sockets:
        s.bind(("127.0.0.1", 0))
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


def from_bag(bag: Path, live: Outcome[Observation, Solution]) -> str:
    """Solve again from the bag alone, and say how well that agrees with the live result."""
    settings = KinematicSettings(arm=str(CONFIG / "cad.yaml"), parametrization="equal")
    offline = solve_bag(KINEMATIC, bag, settings)
    if len(offline.used) != len(live.used):
        # One of the two was killed, and did not listen for a time.
        return (
            f"solved again from the bag: {offline.verdict}, "
            f"from {len(offline.used)} rests in it, {len(live.used)} seen live"
        )
    worst = float(abs(offline.values - live.values).max())
    return f"solved again from the bag: {offline.verdict}, parameters differ by at most {worst:.1e}"


def use_free_domain() -> None:
    """Keep to a ROS domain of its own, unless one is asked for."""
    for domain in range(1, 102):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7410 + 250 * domain))  # of the domain's first participant
            except OSError:
                continue
        os.environ.setdefault("ROS_DOMAIN_ID", str(domain))
        return


def arguments() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        "demo.sh", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="multiple of real time; two cores keep up with 2, four with 5",
    )
    parser.add_argument(
        "--postures",
        type=int,
        choices=range(7, len(DEFAULT) + 1),  # fewer hardly check each other
        default=len(DEFAULT),
        help="to observe: the first so many",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the simulated errors")
    parser.add_argument("--out", type=Path, help="folder for the results; None: out/demo-TIME")
    parser.add_argument(
        "--preset", default="paper", help="of the simulated errors: ideal, default or paper"
    )
    parser.add_argument("--deadline", type=float, default=600.0, help="give up after [s]")
    return parser


def main() -> int:
    """Run; the exit code is 0 if the calibration passes."""
    options = arguments().parse_args()
    out = (options.out or CONFIG.parent / "out" / f"demo-{datetime.now():%Y%m%d-%H%M%S}").absolute()
    if out.exists():
        print(f"demo: {out} is there already, give another --out", file=sys.stderr)
        return 1
    console = report.console()
    use_free_domain()
    console.print(f"starting simulator, {LINKS} drivers over UDP, recorder and calibration")
    rclpy.init()
    try:
        result = run(options, out, console)
        told = KINEMATIC.report_of(result, description.load(CONFIG / "truth.yaml"))
        console.print(report.printed(told))
        console.print(from_bag(out / "bag", result))
        report.write(out / "report", told)
    except (DemoError, ValueError, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        print("demo: interrupted", file=sys.stderr)
        return 130
    finally:
        rclpy.try_shutdown()
    for name, what in (
        ("bag", "recording"),
        ("arm.yaml", "calibrated description"),
        ("report/index.html", "report"),
        ("report/kinematic_observations.png", "residuals"),
        ("report/kinematic_postures.png", "postures"),
        ("logs", "of the nodes"),
    ):
        if (out / name).exists():
            console.print(f"{what:>24}  {out / name}", soft_wrap=True)
    return 0 if result.verdict == PASS else 2


if __name__ == "__main__":
    sys.exit(main())
