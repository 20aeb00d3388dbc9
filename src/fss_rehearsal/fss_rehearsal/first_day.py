"""Rehearse the first day: `check` tests one link alone, as docs/start/hardware.md describes.

The rehearsal runs in real time; a stiff tether holds the base. The fault `drive_<i>.hand` simulates
the operator's hand. The angle by which the hand has turned the joint is read from sim/truth.
"""

import argparse
import subprocess
import threading
from functools import partial
from math import degrees
from pathlib import Path
from typing import IO, Any

import numpy as np
from ament_index_python.packages import get_package_prefix
from rich.console import Console

from fss_arm_bags.reader import open_bags
from fss_arm_model.files import read_yaml
from fss_arm_msgs.msg import SimTruth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.report import Figure
from fss_rehearsal.domain import Domain
from fss_rehearsal.operators import LINKS, Operator, isolated_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.rehearsed import Check, Rehearsed

INITIAL_ANGLE = -0.9  # initial joint angle [rad]
TURNING_TORQUE, LOADING_TORQUE = 0.4, 0.5  # torques of the hand that turn and load the joint [N m]
MIN_TURN = 0.6  # minimum angle by which the hand turns the joint [rad]
MOVING_RATE, REST_RATE = (
    0.05,
    1e-4,
)  # rates above which the joint moves, below which it rests [rad/s]
CHECK_TIMEOUT = 240.0  # timeout of the whole check [s]
FINDINGS_PER_LINK = 9  # expected findings for one link
STIFF_TETHER = {"tether_drag": 1000.0, "tether_twist": 50.0}  # holds the base


class FirstDayOperator(Operator):
    """Operator that answers the prompts of `check`: turns and loads the joint, confirms."""

    def __init__(self, domain: Domain, link: int) -> None:
        super().__init__(domain)
        self.link, self.q, self.rate, self.output = link, 0.0, 0.0, ""
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, 1)

    def on_truth(self, message: SimTruth) -> None:
        """Store the joint's angle and rate."""
        self.q, self.rate = message.q[2 + self.link], message.qd[2 + self.link]

    def read_output(self, source: IO[str], log: IO[str]) -> None:
        """Read the output letter by letter, because prompts end without a newline."""
        while letter := source.read(1):
            self.output += letter
            log.write(letter)

    def apply_torque(self, torque: float) -> None:
        """Apply a torque [N m] of the hand to the joint."""
        self.set_faults({f"drive_{self.link}.hand": torque})

    def turn_joint(self) -> str:
        """Turn the joint; return by how much [deg]."""
        before = self.q
        self.apply_torque(TURNING_TORQUE)
        self.wait(lambda: self.q > before + MIN_TURN, "the joint does not turn by hand")
        self.apply_torque(-TURNING_TORQUE)
        self.wait(lambda: self.rate < MOVING_RATE, "the joint does not stop")
        self.apply_torque(0.0)
        self.wait(lambda: abs(self.rate) < REST_RATE, "the joint does not come to rest")
        return f"{degrees(self.q - before):.3f}"

    def load_joint(self) -> str:
        """Push the joint against its stop; return the torque [N m]."""
        self.apply_torque(LOADING_TORQUE)
        self.wait(lambda: self.rate > MOVING_RATE, "the joint does not turn by hand")
        self.wait(lambda: abs(self.rate) < REST_RATE, "the joint does not reach its end stop")
        self.wait_until(self.now() + SECOND)
        return f"{LOADING_TORQUE}"

    def confirm(self) -> str:
        """Remove the hand's torque and answer yes."""
        self.apply_torque(0.0)
        return "yes"

    def answer_prompt(self, to: IO[str]) -> None:
        """Answer the current prompt, if there is one."""
        answers = {
            "degrees, or nothing to skip this test: ": self.turn_joint,
            "press Enter: ": lambda: "",
            "N m, or nothing to skip this test: ": self.load_joint,
            "type yes: ": self.confirm,
        }
        for question, answer in answers.items():
            if self.output.endswith(question):
                self.output = ""
                to.write(f"{answer()}\n")
                to.flush()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--link", type=int, default=2, choices=range(1, LINKS + 1), help="link to check (default 2)"
    )


def run_check(operator: FirstDayOperator, url: str, out: Path) -> int | None:
    """Run `check` on the link at `url`; return its exit code."""
    program = Path(get_package_prefix("fss_arm_driver"), "lib", "fss_arm_driver", "check")
    command = [str(program), url, "--output", str(out / "check.yaml")]
    with (
        (out / "logs/check.log").open("w", encoding="utf-8") as log,
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process,
    ):
        assert process.stdin
        reader = threading.Thread(target=operator.read_output, args=(process.stdout, log))
        reader.start()

        def has_exited() -> bool:
            assert process.stdin
            operator.answer_prompt(process.stdin)
            return process.poll() is not None

        try:
            operator.wait(
                has_exited,
                f"`check` does not finish within {CHECK_TIMEOUT:g} s, see {log.name}",
                CHECK_TIMEOUT,
            )
        finally:
            process.kill()
            reader.join()
        return process.returncode


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Check the link and read the findings."""
    with isolated_domain() as domain, Nodes(out / "logs", console.print, domain) as nodes:
        console.print(f"starting all nodes in their own ROS domain, {domain.number}")
        nodes.start("record", "fss_arm_bags", "record", output=out / "bag")
        q = np.zeros(LINKS)
        q[options.link - 1] = INITIAL_ANGLE
        nodes.start(
            "testbed",
            "fss_sim",
            "testbed",
            ports=domain.ports(LINKS),
            seed=options.seed,
            q=q.tolist(),
            truth_rate=50.0,
            **STIFF_TETHER,
        )
        operator = FirstDayOperator(domain, options.link)
        operator.wait(lambda: operator.q != 0.0, "the test bed publishes no sim/truth")
        console.print(f"checking link {options.link}")
        code = run_check(operator, domain.urls(LINKS)[options.link - 1], out)
        operator.destroy_node()
    with open_bags(out / "bag") as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
    t = np.array([stamp_ns(message.header.stamp) for message in truths])
    joint = np.array([(m.q[2 + options.link], m.qd[2 + options.link]) for m in truths])
    (found,) = read_yaml(out / "check.yaml")["links"]
    files = {"bag": "recording", "logs": "logs of nodes and check", "check.yaml": "findings"}
    figure = Figure("first_day", f"Joint {options.link}", partial(plot, t, joint))
    return Rehearsed(evaluate(found["findings"], code), [figure], files=files)


def evaluate(findings: list[dict[str, str]], code: int | None) -> list[Check]:
    """Compare the findings and the exit code with what is expected."""
    checks = [
        Check(f"{one['name']}: pass", f"{one['verdict']}: {one['found']}", one["verdict"] == "pass")
        for one in findings
    ]
    complete = len(findings) == FINDINGS_PER_LINK and code == 0
    counted = f"{len(findings)} findings, exit code {code}"
    return [*checks, Check(f"{FINDINGS_PER_LINK} findings, exit code 0", counted, complete)]


def plot(t: np.ndarray, joint: np.ndarray) -> Any:
    """Draw the joint's angle and rate."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(10.0, 5.0), layout="constrained")
    for axes, values, label in zip(
        figure.subplots(2, 1, sharex=True), joint.T, ("angle [rad]", "rate [rad/s]"), strict=True
    ):
        axes.plot((t - t[0]) / SECOND, values, lw=1)
        axes.set_ylabel(label)
    axes.set_xlabel("time [s]")
    return figure
