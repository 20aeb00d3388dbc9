"""Rehearse a capture by the guidance, navigation and control nodes, on a simulated test bed.

Time is simulated, at a chosen speed. The program takes the role of the operator: it arms links and
base, sends the goal mission/capture, evaluates the recording and shows the result.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.task import Future
from rich.console import Console
from std_srvs.srv import SetBool

from fss_arm_model.description_file import load
from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.report import Figure
from fss_rehearsal.animation import animation
from fss_rehearsal.capture_figure import plot
from fss_rehearsal.capture_flight import TARGET, evaluate, read
from fss_rehearsal.domain import CONFIG
from fss_rehearsal.mission_nodes import start_mission_nodes
from fss_rehearsal.operators import LINKS, Operator, isolated_domain
from fss_rehearsal.processes import Nodes, RehearsalError
from fss_rehearsal.rehearsed import Check, Rehearsed

POSTURE = [0.95, 1.3, 1.36, -1.23]  # compact: reaches well from there and turns in little space
INITIAL_PARAMETERS = {
    "base": [-1.1, -1.1, -1.4],
    "q": POSTURE,
    "target_mass": TARGET.mass,
    "target_inertia": TARGET.inertia,
    "target_pose": [0.0, 0.0, -0.3],
}
TARGET_DRIFT = -0.006, 0.004  # [m/s]
NOT_STARTED = (
    "the test bed did not start within {:g} s: it compiles kernels, waits for another process "
    "that does, or has failed; see logs/testbed.log"
)
PHASES = {  # what happens in them
    "wait": "for a path to the target",
    "approach": "the base moves to the target",
    "reach": "the arm moves the gripper to the fixture",
    "grip": "the gripper closes",
    "detumble": "joints and base stop",
}
MAX_DURATION = 600.0  # timeout of the mission [s], in real time


class CaptureOperator(Operator):
    """Operator that arms links and base, and sends the capture goal."""

    TIMEOUT = 120.0  # timeout until all nodes are discovered and armed [s]

    def __init__(self, nodes: Nodes, links: int = LINKS) -> None:
        simulated = [Parameter("use_sim_time", value=True)]
        self.nodes = nodes
        super().__init__(nodes.domain, links, parameter_overrides=simulated)
        self.base = self.create_client(SetBool, "base/arm")
        self.capture = ActionClient(self, Capture, "mission/capture")
        self.phase = ""
        self.create_subscription(MissionState, "mission/state", self.on_state, LATCHED)

    def on_state(self, message: MissionState) -> None:
        """Print each new phase of the mission."""
        if message.mission and message.phase != self.phase:
            self.phase = message.phase
            meaning = message.reason or PHASES.get(self.phase, "")
            print(f"{message.elapsed:8.2f} s  {self.phase:<10} {meaning}".rstrip())

    def wait(self, condition: Callable[[], bool], error: str, timeout: float = 0.0) -> None:
        """Spin until the condition holds.

        Raises:
            RehearsalError: it does not hold within `timeout` [s], or a node exited with an error.
        """

        def is_met() -> bool:
            self.nodes.check_alive()
            return condition()

        super().wait(is_met, error, timeout)

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
            RehearsalError: they are not armed within TIMEOUT, or a node exited with an error.
        """
        self.wait(self.arm.service_is_ready, "node `arm` offers no service")
        deadline = time.monotonic() + self.TIMEOUT
        while not all(self.armed.values()):
            if time.monotonic() > deadline:
                words = f"{self.disarmed} cannot be armed (waited {self.TIMEOUT:g} s)"
                raise RehearsalError(words if self.now() else NOT_STARTED.format(self.TIMEOUT))
            self.nodes.check_alive()
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


def parameters_of(options: argparse.Namespace, arm: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes for the options of this rehearsal."""
    description = {"arm": arm}
    inertia = TARGET.inertia * options.assumed / TARGET.mass
    target = {"target_mass": options.assumed, "target_inertia": inertia}
    twist = [*TARGET_DRIFT, options.spin]
    fingers = gripper(options)
    return {
        "testbed": description
        | INITIAL_PARAMETERS
        | fingers
        | {"seed": options.seed, "target_twist": twist},
        "links": description,
        "arm": description,
        "navigation": description | target,
        "control": description | target,
        "guidance": description
        | target
        | fingers
        | {"posture": POSTURE, "cancel_momentum": options.cancel_momentum},
    }


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
    parser.add_argument(
        "--cancel-momentum",
        action="store_true",
        help="approach with a momentum opposite to the target's",
    )


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
        log_line(f"starting all nodes in their own ROS domain, {domain.number}")
        parameters = parameters_of(options, CONFIG / "arm.yaml")
        start_mission_nodes(nodes, arm.n, parameters, options.speed, out / "bag")
        operator = CaptureOperator(nodes)
        operator.arm_all()
        log_line("phases of the mission, with the times of their start:")
        begin = time.monotonic()
        result = operator.run_capture()
        elapsed = time.monotonic() - begin
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
    ratio = f"{result.duration / elapsed:.2f} times real time, {options.speed:g} requested"
    for line in (end, *consumption, f"  simulated in {elapsed:.0f} s: {ratio}"):
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
        f"  momentum of all bodies at the grip, estimated: x {x:+#.4g}, y {y:+#.4g} N s,\n"
        f"    about the common centre of mass {turning:+#.4g} N m s"
    )
    return [
        f"result of the guidance: {end}",
        f"  duration {result.duration:.1f} s, propellant estimated by the nodes "
        f"{1e3 * result.propellant:.1f} g",
        "  no grip" if np.isnan(x) else momentum,
        f"  largest measured joint torque {result.largest_torque:.2f} N m",
    ]
