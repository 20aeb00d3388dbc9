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
from fss_arm_calib.report import Figure
from fss_arm_model.files import read_yaml
from fss_arm_msgs.msg import SimTruth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_rehearsal.domain import Domain
from fss_rehearsal.person import LINKS, Operator, own_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.rehearsed import Check, Rehearsed

BEGIN = -0.9  # initial joint angle [rad]
TURN, PUSH = 0.4, 0.5  # torques of the hand that turn and load the joint [N m]
ANGLE = 0.6  # minimum angle by which the hand turns the joint [rad]
MOVING, STILL = 0.05, 1e-4  # rates above which the joint moves, below which it rests [rad/s]
DEADLINE = 240.0  # timeout of the whole check [s]
FINDINGS = 9  # expected findings for one link
TETHER = {"tether_drag": 1000.0, "tether_twist": 50.0}  # holds the base


class Person(Operator):
    """Operator that answers the prompts of `check`: turns and loads the joint, confirms."""

    def __init__(self, domain: Domain, link: int) -> None:
        super().__init__(domain)
        self.link, self.q, self.rate, self.asked = link, 0.0, 0.0, ""
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, 1)

    def on_truth(self, message: SimTruth) -> None:
        """Store the joint's angle and rate."""
        self.q, self.rate = message.q[2 + self.link], message.qd[2 + self.link]

    def listen(self, source: IO[str], log: IO[str]) -> None:
        """Read the output letter by letter, because prompts end without a newline."""
        while letter := source.read(1):
            self.asked += letter
            log.write(letter)

    def push(self, torque: float) -> None:
        """Apply a torque [N m] of the hand to the joint."""
        self.put({f"drive_{self.link}.hand": torque})

    def turn(self) -> str:
        """Turn the joint; return by how much [deg]."""
        before = self.q
        self.push(TURN)
        self.wait(lambda: self.q > before + ANGLE, "the joint does not turn by hand")
        self.push(-TURN)
        self.wait(lambda: self.rate < MOVING, "the joint does not stop")
        self.push(0.0)
        self.wait(lambda: abs(self.rate) < STILL, "the joint does not rest")
        return f"{degrees(self.q - before):.3f}"

    def load(self) -> str:
        """Push the joint against its stop; return the torque [N m]."""
        self.push(PUSH)
        self.wait(lambda: self.rate > MOVING, "the joint does not turn by hand")
        self.wait(lambda: abs(self.rate) < STILL, "the joint does not come to its stop")
        self.stay(self.now() + SECOND)
        return f"{PUSH}"

    def agree(self) -> str:
        """Remove the hand's torque and answer yes."""
        self.push(0.0)
        return "yes"

    def reply(self, to: IO[str]) -> None:
        """Answer the current prompt, if there is one."""
        ways = {
            "degrees, or nothing to leave it out: ": self.turn,
            "press Enter: ": lambda: "",
            "in N m, or nothing to leave it out: ": self.load,
            "type yes: ": self.agree,
        }
        for question, way in ways.items():
            if self.asked.endswith(question):
                self.asked = ""
                to.write(f"{way()}\n")
                to.flush()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument("--link", type=int, default=2, choices=range(1, LINKS + 1), help="which")


def attempt(person: Person, url: str, out: Path) -> int | None:
    """Run `check` on the link at `url`; return its exit code."""
    program = Path(get_package_prefix("fss_arm_driver"), "lib", "fss_arm_driver", "check")
    command = [str(program), url, "--output", str(out / "check.yaml")]
    with (
        (out / "logs/check.log").open("w", encoding="utf-8") as log,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True,
        ) as process,
    ):  # fmt: skip
        assert process.stdin
        listener = threading.Thread(target=person.listen, args=(process.stdout, log))
        listener.start()

        def ended() -> bool:
            assert process.stdin
            person.reply(process.stdin)
            return process.poll() is not None

        try:
            person.wait(ended, f"check does not end, see {log.name}", DEADLINE)
        finally:
            process.kill()
            listener.join()
        return process.returncode


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Check the link and read the findings."""
    with own_domain() as domain, Nodes(out / "logs", console.print, domain) as nodes:
        console.print(f"starting simulator and recorder, in ROS domain {domain.number}")
        nodes.start("record", "fss_arm_bags", "record", output=out / "bag")
        q = np.zeros(LINKS)
        q[options.link - 1] = BEGIN
        nodes.start(
            "testbed", "fss_sim", "testbed", ports=domain.ports(LINKS), seed=options.seed,
            q=q.tolist(), truth_rate=50.0, **TETHER,
        )  # fmt: skip
        person = Person(domain, options.link)
        person.wait(lambda: person.q != 0.0, "the test bed is silent")
        console.print(f"trying link {options.link}")
        code = attempt(person, domain.urls(LINKS)[options.link - 1], out)
        person.destroy_node()
    with open_bags(out / "bag") as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
    t = np.array([stamp_ns(message.header.stamp) for message in truths])
    joint = np.array([(m.q[2 + options.link], m.qd[2 + options.link]) for m in truths])
    (found,) = read_yaml(out / "check.yaml")["links"]
    files = {"bag": "recording", "logs": "of nodes and check", "check.yaml": "findings"}
    figure = Figure("first_day", f"Joint {options.link}", partial(plot, t, joint))
    return Rehearsed(judge(found["findings"], code), [figure], files=files)


def judge(findings: list[dict[str, str]], code: int | None) -> list[Check]:
    """Compare the findings and the exit code with what is expected."""
    checks = [
        Check(f"{one['name']}: pass", f"{one['verdict']}: {one['found']}", one["verdict"] == "pass")
        for one in findings
    ]
    complete = len(findings) == FINDINGS and code == 0
    counted = f"{len(findings)} findings, exit code {code}"
    return [*checks, Check(f"{FINDINGS} findings, exit code 0", counted, complete)]


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
