"""Rehearse a capture by the guidance, navigation and control nodes, on a simulated test bed.

Time is simulated, at a chosen speed. The program takes the role of the operator: it arms links and
base, sends the goal mission/capture, evaluates the recording and shows the result.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.task import Future
from rich.console import Console
from std_srvs.srv import SetBool

from fss_arm_bags.reader import open_bags
from fss_arm_model.description import Arm
from fss_arm_model.description_file import load
from fss_arm_model.held import Target, payload_pose
from fss_arm_model.kinematics import joint_positions
from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import MassProperties, MissionState
from fss_arm_ros import palette
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.report import Figure
from fss_rehearsal.animation import animation
from fss_rehearsal.domain import CONFIG, Domain
from fss_rehearsal.operators import LINKS, Operator, isolated_domain
from fss_rehearsal.processes import Nodes, RehearsalError
from fss_rehearsal.rehearsed import Check, Rehearsed

TARGET = Target(mass=10.0, inertia=0.25)
POSTURE = [0.95, 1.3, 1.36, -1.23]  # compact: reaches well from there and turns in little space
INITIAL_PARAMETERS = {
    "base": [-1.1, -1.1, -1.4],
    "q": POSTURE,
    "target_mass": TARGET.mass,
    "target_inertia": TARGET.inertia,
    "target_pose": [0.0, 0.0, -0.3],
}
UNITS = "kg", "m", "m", "kg m^2"  # of mass, centre of mass and inertia
TARGET_DRIFT = -0.006, 0.004  # [m/s]
MAX_DURATION = 600.0  # timeout of the mission [s], in real time
MOMENTUM_TOLERANCE = 1e-9  # tolerance for momentum before and after the capture [N s, N m s]


class CaptureOperator(Operator):
    """Operator that arms links and base, and sends the capture goal."""

    TIMEOUT = 120.0  # timeout until all nodes are discovered and armed [s]

    def __init__(self, domain: Domain, links: int = LINKS) -> None:
        simulated = [Parameter("use_sim_time", value=True)]
        super().__init__(domain, links, parameter_overrides=simulated)
        self.base = self.create_client(SetBool, "base/arm")
        self.capture = ActionClient(self, Capture, "mission/capture")
        self.phase = ""
        self.create_subscription(MissionState, "mission/state", self.on_state, LATCHED)

    def on_state(self, message: MissionState) -> None:
        """Print each new phase of the mission."""
        if message.mission and message.phase != self.phase:
            self.phase = message.phase
            print(f"{message.elapsed:6.1f} s  {self.phase}  {message.reason}".rstrip())

    def result_of(self, future: Future, error: str, timeout: float = 0.0) -> Any:
        """Wait for a future and return its result.

        Raises:
            RehearsalError: the future is not done within `timeout` [s] (0: TIMEOUT).
        """
        self.wait(future.done, error, timeout)
        return future.result()

    def arm_all(self) -> None:
        """Arm the links and the base.

        Raises:
            RehearsalError: they are not armed within TIMEOUT.
        """
        self.wait(self.arm.service_is_ready, "node `arm` offers no service")
        deadline = time.monotonic() + self.TIMEOUT
        while not all(self.armed.values()):
            if time.monotonic() > deadline:
                raise RehearsalError(f"{self.disarmed} cannot be armed (waited {self.TIMEOUT:g} s)")
            self.keep_armed()
            rclpy.spin_once(self, timeout_sec=0.05)
        self.wait(self.base.service_is_ready, "node `base` offers no service")
        request, answer = SetBool.Request(data=True), None
        while answer is None or not answer.success:
            if time.monotonic() > deadline:
                raise RehearsalError(f"the base cannot be armed: {answer and answer.message}")
            answer = self.result_of(self.base.call_async(request), "node `base` does not respond")

    def run_capture(self) -> Capture.Result:
        """Send the capture goal and return the mission's result.

        Raises:
            RehearsalError: the guidance does not respond, or the mission does not end in time.
        """
        self.wait(self.capture.server_is_ready, "node `guidance` offers no action")
        sent = self.capture.send_goal_async(Capture.Goal(detumble=True))
        handle = self.result_of(sent, "node `guidance` does not respond")
        answer = handle.get_result_async()
        return self.result_of(answer, "the mission does not end", MAX_DURATION).result


def start_all(nodes: Nodes, options: argparse.Namespace, arm: Path, out: Path) -> None:
    """Start all nodes, with the options of this rehearsal."""
    clock, ports = {"use_sim_time": True}, nodes.domain.ports(2 * LINKS + 2)
    board, base = ports[2 * LINKS :]
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag", **clock)
    nodes.start(
        "testbed",
        "fss_sim",
        "testbed",
        arm=arm,
        seed=options.seed,
        ports=ports[:LINKS],
        board_port=board,
        keep_clock=True,
        speed=options.speed,
        lockstep=True,
        truth_rate=50.0,
        telemetry_rate=20.0,
        **INITIAL_PARAMETERS,
        target_twist=[*TARGET_DRIFT, options.spin],
        **gripper(options),
    )
    nodes.start(
        "links",
        "fss_arm_driver",
        "link",
        arm=arm,
        urls=nodes.domain.urls(LINKS),
        rate=20.0,
        timeout=10.0,
        watchdog=10.0,
        **clock,
    )
    nodes.start("arm", "fss_arm_driver", "arm", arm=arm, rate=20.0, time_to_live=10.0, **clock)
    url = f"udp://127.0.0.1:{board}?bind={base}"
    nodes.start("base", "fss_base_driver", "base", url=url, timeout=10.0, **clock)
    inertia = TARGET.inertia * options.assumed / TARGET.mass
    target = {"target_mass": options.assumed, "target_inertia": inertia}
    nodes.start("navigation", "fss_gnc", "navigation", arm=arm, **target, **clock)
    nodes.start("control", "fss_gnc", "control", arm=arm, max_pause=10.0, **target, **clock)
    target |= {"posture": POSTURE, **gripper(options)}
    nodes.start("guidance", "fss_gnc", "guidance", arm=arm, **target, **clock)


class Flight(NamedTuple):
    """Recorded mission, mainly from sim/truth; arrays (k, ...) unless noted."""

    time: np.ndarray  # since the start of the mission [s]
    q: np.ndarray
    qd: np.ndarray
    target: np.ndarray
    target_twist: np.ndarray
    holds: np.ndarray
    momentum: np.ndarray  # of all bodies
    impulse: np.ndarray  # part of the momentum that came from outside
    error: np.ndarray  # audit errors of momentum and energy
    propellant: np.ndarray
    valves: np.ndarray  # True for open valves
    planned: np.ndarray  # (m, 3) reference poses of the base
    phases: list[tuple[float, str]]  # start time [s] and name of each phase
    estimate: MassProperties | None  # last estimate of the target's mass properties


def read(bag: Path) -> Flight:
    """Read the mission from its bag.

    Raises:
        RehearsalError: the bag has no sim/truth.
    """
    with open_bags(bag) as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
        states = [message for _, _, _, message in bags.messages({"/mission/state"})]
        estimate = [message for *_, message in bags.messages({"/target/mass_properties"})]
    if not truths:
        raise RehearsalError(f"the bag {bag} contains no sim/truth")

    def column(name: str) -> np.ndarray:
        return np.array([getattr(message, name) for message in truths])

    stamps = np.array([stamp_ns(message.header.stamp) for message in truths]) / SECOND
    error = np.column_stack([column("momentum_error"), column("energy_error")])
    phases: list[tuple[float, str]] = []
    for state in states:
        if state.mission and (not phases or phases[-1][1] != state.phase):
            phases.append((stamp_ns(state.header.stamp) / SECOND, state.phase))
    start = phases[0][0] if phases else 0.0
    phases = [(since - start, phase) for since, phase in phases]
    planned = np.array([state.reference for state in states]).reshape(-1, 3)
    return Flight(
        stamps - start,
        column("q"),
        column("qd"),
        column("target"),
        column("target_twist"),
        column("holds"),
        column("momentum"),
        column("impulse"),
        error,
        column("propellant"),
        column("valves"),
        planned,
        phases,
        estimate[-1] if estimate else None,
    )


def mass_errors(flight: Flight, p: np.ndarray, k: int) -> tuple[float, list[str]]:
    """Return the largest error of the target's estimate, in standard deviations, and its lines.

    The true values are those of the capture, at row k.
    """
    if flight.estimate is None:
        return np.inf, ["mass of the target: not estimated"]
    m = flight.estimate
    values = np.array([m.mass, *m.com, m.inertia])
    deviations = np.sqrt(m.covariance.reshape(4, 4).diagonal())
    pose = payload_pose(p, flight.q[k], flight.target[k])
    truth = np.array([TARGET.mass, *pose[:2], TARGET.inertia])
    rows = zip(("mass", "x", "y", "inertia"), values, deviations, truth, UNITS, strict=True)
    lines = [
        f"  {name:>16}  {value:+.3f} ± {deviation:.3f} {unit}, true {true:+.3f}"
        for name, value, deviation, true, unit in rows
    ]
    title = "target, ± 1 sigma; centre of mass in the last link's frame:"
    return float((np.abs(values - truth) / deviations).max()), [title, *lines]


def evaluate(flight: Flight, p: np.ndarray, log_line: Callable[[str], None]) -> list[Check]:
    """Print a summary of the mission, and return its checks."""
    capture_check = Check("the target is captured", "not captured", False)
    if not flight.holds.any():
        log_line("the target was not captured")
        return [capture_check]
    k = int(np.argmax(flight.holds))
    change = flight.momentum[k] - flight.momentum[k - 1]
    impulse = flight.impulse[k] - flight.impulse[k - 1]
    when = f"captured between {flight.time[k - 1]:.2f} and {flight.time[k]:.2f} s"
    log_line(when)
    log_line("true momentum of all bodies just before and after the grip:")
    for name, unit, i in (("x", "N s", 0), ("y", "N s", 1), ("about the origin", "N m s", 2)):
        before, after = flight.momentum[k - 1, i], flight.momentum[k, i]
        log_line(f"  {name:>16}  before {before:+#.4g}  after {after:+#.4g} {unit}")
    worst, audit = float(np.abs(change - impulse).max()), float(np.abs(flight.error).max())
    difference = (
        f"changed by at most {worst:.1e} N s, N m s; without a cause in the whole mission at most "
        f"{audit:.1e} N s, N m s, J"
    )
    spin = np.degrees(flight.target_twist[[0, -1], 2])
    rest = np.round(spin[1], 3) + 0.0  # never -0.000
    spin_text = f"{spin[0]:.2f} deg/s at the start, {rest:.3f} deg/s at the end"
    log_line(f"  {difference}")
    log_line(f"spin of the target: {spin_text}")
    log_line(f"propellant used: {1e3 * flight.propellant[-1]:.1f} g")
    sigmas, lines = mass_errors(flight, p, k)
    for line in lines:
        log_line(line)
    return [
        Check(
            "mass, centre of mass and inertia of the target are within 3 sigma",
            f"largest error {sigmas:.1f} sigma",
            sigmas < 3.0,
        ),
        capture_check._replace(happened=when, passed=True),
        Check(
            f"momentum before and after the grip agrees to {MOMENTUM_TOLERANCE:g} N s, N m s",
            difference,
            worst < MOMENTUM_TOLERANCE,
        ),
        Check(
            "the target's spin falls below a tenth", spin_text, abs(spin[1]) < 0.1 * abs(spin[0])
        ),
    ]


def plot(arm: Arm, flight: Flight) -> Any:
    """Draw the mission from above, and momentum and motion over time."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(13.0, 9.0), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=(1.5, 1.0))
    above = figure.add_subplot(grid[:, 0])
    above.set(xlim=(-2, 2), ylim=(-2, 2), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.set_title("from above; pale: start, medium: capture, dark: end")
    k = int(np.argmax(flight.holds)) if flight.holds.any() else len(flight.time) - 1
    for i, shade in ((0, 0.35), (k, 0.65), (len(flight.time) - 1, 1.0)):
        draw_scene(above, arm, flight.q[i], flight.target[i], shade)
    above.plot(
        *flight.planned[:, :2].T, color=palette.PREDICTED, lw=3, alpha=0.4, label="base, planned"
    )
    above.plot(*flight.q[:, :2].T, color=palette.MEASURED, ls=":", lw=1, label="base")
    above.plot(*flight.target[:, :2].T, color=palette.TARGET, ls=":", lw=1, label="target")
    above.legend(loc="upper left")
    panels: tuple[tuple[str, list[tuple[str, Any]]], ...] = (
        (
            "rotation rate\n[deg/s]",
            [
                ("base", np.degrees(flight.qd[:, 2])),
                ("target", np.degrees(flight.target_twist[:, 2])),
            ],
        ),
        (
            "joint angle\n[deg]",
            [(f"joint {j}", np.degrees(flight.q[:, 2 + j])) for j in range(1, arm.n + 1)],
        ),
        (
            "momentum about\nthe origin [N m s]",
            [
                ("all bodies", flight.momentum[:, 2]),
                ("initial, and\nby thrusters", flight.momentum[0, 2] + flight.impulse[:, 2]),
            ],
        ),
    )
    for row, (quantity, lines) in enumerate(panels):
        panel = figure.add_subplot(grid[row, 1])
        for name, values in lines:
            panel.plot(flight.time, values, lw=1, label=name)
        panel.set(xlim=flight.time[[0, -1]], xlabel="time [s]", ylabel=quantity)
        panel.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        panel.grid(alpha=0.25)
    starts = [since for since, _ in flight.phases]
    ends = [*starts[1:], flight.time[-1]]
    panel = figure.add_subplot(grid[3, 1])
    for (since, phase), end in zip(flight.phases, ends, strict=True):
        panel.barh(phase, end - since, left=since, color=palette.STATIC)
    panel.invert_yaxis()
    panel.tick_params(axis="y", labelsize=8)
    panel.set(xlim=flight.time[[0, -1]], xlabel="time [s]", ylabel="phase")
    return figure


def draw_scene(axes: Any, arm: Arm, q: np.ndarray, target: np.ndarray, shade: float) -> None:
    """Draw base, arm and target at one time."""
    square = 0.135 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j, 1 + 1j])
    for (x, y, heading), colour in ((q[:3], palette.MEASURED), (target, palette.TARGET)):
        corners = complex(x, y) + square * np.exp(1j * heading)
        axes.plot(corners.real, corners.imag, color=colour, alpha=shade)
    fixture = complex(*target[:2]) + complex(*TARGET.fixture[:2]) * np.exp(1j * target[2])
    pin = [target[0], fixture.real], [target[1], fixture.imag]
    axes.plot(*pin, color=palette.TARGET, lw=1, alpha=shade)
    joints = joint_positions(arm.vector(), q)
    axes.plot(*joints.T, "o-", color=palette.MEASURED, ms=4, alpha=shade)
    axes.plot([q[0], joints[0, 0]], [q[1], joints[0, 1]], color=palette.MEASURED, alpha=shade)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        help="speed of the simulation, in multiples of real time (default 1)",
    )
    help_text = (
        f"mass of the target that the nodes assume [kg] (default {TARGET.mass:g}, the true one)"
    )
    parser.add_argument("--assumed", type=float, default=TARGET.mass, help=help_text)
    parser.add_argument(
        "--spin", type=float, default=0.15, help="turn rate of the target [rad/s] (default 0.15)"
    )
    add_gripper_options(parser)


def add_gripper_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the gripper."""
    for name, help_text in (
        ("--closing-time", "time that the fingers take to close [s] (default 0)"),
        ("--force", "force at which the grip slides [N] (default 0: no limit)"),
        ("--torque", "torque at which the grip slides [N m] (default 0: no limit)"),
    ):
        parser.add_argument(name, type=float, default=0.0, help=help_text)


def gripper(options: argparse.Namespace) -> dict[str, float]:
    """Return the parameters of test bed and guidance for the options of the gripper."""
    return {
        "grip_closing_time": options.closing_time,
        "grip_force": options.force,
        "grip_torque": options.torque,
    }


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Fly the mission, and evaluate its bag."""
    arm = load(CONFIG / "arm.yaml")
    log_line = partial(console.print, soft_wrap=True, highlight=False)
    with isolated_domain() as domain, Nodes(out / "logs", log_line, domain) as nodes:
        log_line(f"starting test bed, drivers, recorder and guidance in ROS domain {domain.number}")
        start_all(nodes, options, CONFIG / "arm.yaml", out)
        operator = CaptureOperator(domain)
        operator.arm_all()
        result = operator.run_capture()
        operator.destroy_node()
    flight = read(out / "bag")
    end, *consumption = budget(result)
    checks = [
        *evaluate(flight, arm.vector(), log_line),
        Check(
            "the guidance reports success",
            end.removeprefix("result of the guidance: "),
            result.stopped,
        ),
    ]
    for line in (end, *consumption):
        log_line(line)
    figure = Figure("mission", "Top view and time histories", partial(plot, arm, flight))
    film = animation(
        arm,
        flight.time,
        flight.q,
        flight.target,
        flight.holds,
        flight.valves,
        flight.phases,
        TARGET.fixture,
    )
    files = {"bag": "recording", "report/mission.png": "figure", "logs": "logs of the nodes"}
    return Rehearsed(checks, [figure], files=files, html=film)


def budget(result: Capture.Result) -> list[str]:
    """Return the mission's time, propellant, momentum and torque, as the guidance reports them."""
    x, y, turning = result.momentum.tolist()
    end = "captured and stopped" if result.stopped else f"{result.phase}: {result.message}"
    momentum = (
        f"  estimated momentum at the grip: x {x:+#.4g}, y {y:+#.4g} N s, "
        f"about the common centre of mass {turning:+#.4g} N m s"
    )
    return [
        f"result of the guidance: {end}",
        f"  time {result.duration:.1f} s, propellant by the nodes {1e3 * result.propellant:.1f} g",
        "  no grip" if np.isnan(x) else momentum,
        f"  largest joint torque {result.largest_torque:.2f} N m",
    ]
