"""Rehearse a drift calibration: the arm rests, the base drifts over a tilted table with a hose.

Test bed, drivers, recorder and the node `drift` run in simulated time. Then the calibration is
solved again from the bag alone.
"""

import argparse
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from rich.console import Console
from std_srvs.srv import Trigger

from fss_arm_bags.reader import open_bags
from fss_arm_calib.acceptance import PASS, format_count
from fss_arm_calib.drift.kind import DRIFT
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.outcome import Outcome
from fss_arm_model.units import GRAVITY
from fss_arm_msgs.msg import DriftCalibration, SimTruth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.report import Figure
from fss_rehearsal.domain import CONFIG, Domain
from fss_rehearsal.operators import LINKS, Operator, isolated_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.rehearsed import Check, Rehearsed

TILT = 2e-5, -1e-5  # tilt of the table [rad]
DRAG, TWIST_DAMPING = 0.02, 0.01  # damping by the hose [N s/m, N m s]
INITIAL_POSE = -0.6, 0.0, 0.0  # initial pose from which the arm stays clear of the table's border
INITIAL_TWIST = -0.006, 0.003, 0.004  # initial twist of the base [m/s, m/s, rad/s]
TRUTH = {
    "g_x": GRAVITY * TILT[0],
    "g_y": GRAVITY * TILT[1],
    "torque": 0.0,
    "twist_damping": TWIST_DAMPING,
    "drag": DRAG,
}
MAX_SEGMENT = 40.0  # maximum duration of one drift segment, so that segments check each other [s]
MAX_DEVIATIONS = 3.0  # maximum error of an estimate, in standard deviations


class DriftOperator(Operator):
    """Operator that lets the base drift, and requests the solution."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, parameter_overrides=[Parameter("use_sim_time", value=True)])
        self.start_time = self.time = 0
        self.result: DriftCalibration | None = None
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, 1)
        self.create_subscription(DriftCalibration, "calibration/drift", self.on_result, LATCHED)
        self.solve = self.create_client(Trigger, "drift/solve")

    def on_truth(self, message: SimTruth) -> None:
        """Store the simulated time, and its first value."""
        self.time = stamp_ns(message.header.stamp)
        self.start_time = self.start_time or self.time

    def on_result(self, message: DriftCalibration) -> None:
        """Store the newest result."""
        self.result = message

    def drift(self, seconds: float, speed: float) -> DriftCalibration:
        """Wait for `seconds` of simulated time, then request the solution and return it."""
        timeout = 60.0 + 4.0 * seconds / speed
        message = f"the simulation does not reach {seconds:g} s within {timeout:g} s"
        self.wait(lambda: self.time > self.start_time + seconds * SECOND > SECOND, message, timeout)
        self.wait(self.solve.service_is_ready, "service drift/solve is not available")
        self.result = None
        answer = self.solve.call_async(Trigger.Request())
        self.wait(
            lambda: answer.done() and self.result is not None, "node `drift` publishes no solution"
        )
        assert self.result
        return self.result


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--seconds",
        type=float,
        default=90.0,
        help="simulated duration of the drift [s] (default 90)",
    )
    parser.add_argument(
        "--speed",
        type=float,
        default=3.0,
        help="speed of the simulation, in multiples of real time (default 3)",
    )
    parser.add_argument(
        "--preset", default="laboratory", help="preset of the simulator (default %(default)s)"
    )


def start_all(nodes: Nodes, options: argparse.Namespace, out: Path) -> None:
    """Start all nodes."""
    arm, clock = CONFIG / "truth.yaml", {"use_sim_time": True}
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag", **clock)
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        timeout = max(1.0, options.speed)
        nodes.start(
            f"link_{i}", "fss_arm_driver", "link", link=i, url=url, timeout=timeout, **clock
        )
    nodes.start("arm", "fss_arm_driver", "arm", **clock)
    nodes.start(
        "drift",
        "fss_arm_calib",
        "drift",
        arm=arm,
        output=out / "drift.yaml",
        max_duration=MAX_SEGMENT,
        **clock,
    )
    nodes.start(
        "testbed",
        "fss_sim",
        "testbed",
        arm=arm,
        seed=options.seed,
        preset=options.preset,
        ports=nodes.domain.ports(LINKS),
        keep_clock=True,
        speed=options.speed,
        tilt=list(TILT),
        tether_drag=DRAG,
        tether_twist=TWIST_DAMPING,
        base=list(INITIAL_POSE),
        twist=list(INITIAL_TWIST),
        q=[0.4, -0.8, 0.8, -0.4],
    )


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Let the base drift, solve, and solve again from the bag."""
    with isolated_domain() as domain, Nodes(out / "logs", console.print, domain) as nodes:
        console.print(f"starting all nodes in their own ROS domain, {domain.number}")
        start_all(nodes, options, out)
        operator = DriftOperator(domain)
        live = operator.drift(options.seconds, options.speed)
        operator.destroy_node()
    settings = DriftSettings(arm=str(CONFIG / "truth.yaml"), max_duration=MAX_SEGMENT)
    offline = solve_bag(DRIFT, out / "bag", settings)
    with open_bags(out / "bag") as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
    t = np.array([stamp_ns(message.header.stamp) for message in truths]) / SECOND
    base = np.array([message.q[:3] for message in truths])
    figure = Figure("drift", "True drift of the base", partial(plot, t - t[0], base))
    files = {"bag": "recording", "drift.yaml": "parameters for nodes", "logs": "logs of the nodes"}
    return Rehearsed(evaluate(live, offline), [figure], [DRIFT.report_of(offline)], files)


def evaluate(live: DriftCalibration, offline: Outcome[Any, Any]) -> list[Check]:
    """Compare the results with each other and with the truth.

    Args:
        live: result of the node.
        offline: result from the bag.
    """
    result = live.calibration
    live_text = f"{result.verdict} from {format_count(result.used, 'drift')}"
    checks = [
        Check("the calibration passes", live_text, result.verdict == PASS),
        Check(
            "the bag alone gives the same verdict",
            f"{offline.verdict}: {offline.summary}",
            offline.verdict == result.verdict,
        ),
    ]
    units = dict(zip(offline.estimate.names, offline.estimate.units, strict=True))
    for name, value, deviation in zip(result.names, result.values, result.deviations, strict=True):
        unit, error = units[name], (value - TRUTH[name]) / deviation
        found = f"{value:.3g} ± {deviation:.2g} {unit}, error {abs(error):.1f} deviations"
        # The damping of turns is smaller than this drift can show: it may end at its bound.
        if at_bound := name == "twist_damping" and value == 0.0 and not isfinite(deviation):
            found = f"0 {unit}, its bound: not determined by this drift"
        checks.append(
            Check(
                f"{name} is within {MAX_DEVIATIONS:g} deviations of the truth, "
                f"{TRUTH[name]:.3g} {unit}",
                found,
                at_bound or bool(isfinite(deviation) and abs(error) < MAX_DEVIATIONS),
            )
        )
    return checks


def plot(t: np.ndarray, base: np.ndarray) -> Any:
    """Draw the base's path and heading."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(10.0, 4.0), layout="constrained")
    above, turned = figure.subplots(1, 2)
    above.plot(base[:, 0], base[:, 1])
    above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    turned.plot(t, base[:, 2])
    turned.set(xlabel="time [s]", ylabel="heading [rad]")
    return figure
