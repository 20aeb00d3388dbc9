"""Motions of a floating base, by nodes alone on the simulated test bed with its default errors.

    . scripts/env.sh; python bench/bench_floating.py [SEEDS] [DEGREES]

By seed of the sensors' errors: config/cad.yaml is calibrated, kinematically and dynamically, from
thirteen rests and the moves between them (in one process, as bench_laboratory.py does), and what
that leaves is all that the nodes know of the arm. They fly a reorientation, zero reaction and
the straight move between its two postures, and half a metre of the end effector along a line in
the world. Headings are those of `base_reaction`; the line is measured on `sim/truth`. Exits with 1
if a reorientation ended further from its prediction than 3 sigma of what `arm/motion` says.
"""

import sys
from pathlib import Path
from tempfile import mkdtemp
from time import monotonic

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from running import OWN  # enters a ROS domain of its own: before rclpy

import rclpy  # isort: skip
from motion_person import Person  # isort: skip
from rclpy.executors import SingleThreadedExecutor  # isort: skip
from rich.console import Console  # isort: skip
from rich.table import Table  # isort: skip
from sim_rehearsal import DYNAMIC, Rehearsal  # isort: skip

from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_model.description_file import from_yaml, load
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import BaseReaction
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import SENSOR
from fss_rehearsal.processes import Nodes

CONFIG = Path(__file__).parents[1] / "config"
BENT = [-50.0, 55.0, 45.0, 40.0]  # [deg]
LINE = [0.5 * np.cos(3.7), 0.5 * np.sin(3.7)]  # [m]
PATIENT = {"timeout": 4.0, "watchdog": 6.0}  # of a computer that does other things, too
SETTLED = 1.0  # after a motion [s]
SECOND = 1_000_000_000


class Flight(Person):
    """A person who keeps what `base_reaction` said."""

    def __init__(self):
        self.executor_ = SingleThreadedExecutor()
        super().__init__(self.until)
        self.executor_.add_node(self)
        self.reactions = []
        self.create_subscription(BaseReaction, "base_reaction", self.reactions.append, SENSOR)

    def until(self, _, condition, timeout=60.0):
        """Spin until it holds."""
        deadline = monotonic() + timeout
        while not condition():
            if monotonic() > deadline:
                raise TimeoutError(f"not within {timeout} s")
            self.executor_.spin_once(timeout_sec=0.02)

    def motion(self, kind, *arguments, **goal):
        """Its report, and what was heard from its begin until the arm rests."""
        ended = self.execute(kind=kind, arguments=[str(one) for one in arguments], **goal)
        if not ended.result.reached:
            raise RuntimeError(f"{kind}: {ended.result.message}")
        report = ended.result.report
        begin = stamp_ns(report.header.stamp)
        end = begin + round((report.duration + SETTLED) * SECOND)

        def stamp(one):
            return stamp_ns(one.header.stamp)

        self.until(self, lambda: stamp(self.reactions[-1]) > end and stamp(self.truths[-1]) > end)
        during = [
            [one for one in all_ if begin <= stamp(one) <= end]
            for all_ in (self.reactions, self.truths)
        ]
        self.reactions.clear()
        self.truths.clear()
        return report, *during


def turned(report, reactions):
    """By how much the base was turned at the end, and at most [deg]."""
    rests = stamp_ns(report.header.stamp) + round((report.duration + 0.5 * SETTLED) * SECOND)
    heading = np.degrees([one.measured[2] for one in reactions])
    ended = [stamp_ns(one.header.stamp) > rests for one in reactions]
    return heading[ended].mean() - heading[0], np.abs(heading - heading[0]).max()


def off_line(arm, truths):
    """Farthest off the line, and the end from where it ends, of the true end effector [mm]."""
    tip = tip_pose(arm.vector(), np.array([one.q for one in truths]))[:, :2]
    from_begin, along = tip - tip[0], np.array(LINE) / np.linalg.norm(LINE)
    across = from_begin @ [-along[1], along[0]]
    return 1e3 * np.abs(across).max(), 1e3 * np.linalg.norm(from_begin[-1] - LINE)


def calibrated(seed):
    """The description that a seed's experiment leaves."""
    run = Rehearsal(CONFIG, seed=seed, preset="default")
    run.run()
    found = calibrate(run.observations, run.guess, KinematicSettings(), run.finder.streams())
    kinematic, streams = from_yaml(found.description), run.maneuver_finder.streams()
    return calibrate_dynamics(run.maneuvers, kinematic, DYNAMIC, streams).description


def fly(seed, degrees, say):
    """One seed's row."""
    logs = Path(mkdtemp(prefix="bench_floating_"))
    arm = logs / "arm.yaml"
    arm.write_text(calibrated(seed))
    rclpy.init()
    with Nodes(logs, say, OWN) as nodes:
        nodes.start(
            "testbed", "fss_sim", "testbed", arm=CONFIG / "truth.yaml", seed=seed,
            ports=OWN.ports(4), truth_rate=50.0,
        )  # fmt: skip
        nodes.start("links", "fss_arm_driver", "link", urls=OWN.urls(4), arm=arm, **PATIENT)
        nodes.start("arm", "fss_arm_driver", "arm", arm=arm, time_to_live=4.0)
        nodes.start("base_reaction", "fss_arm_view", "base_reaction", arm=arm)
        nodes.start("motion", "fss_arm_motion", "motion", arm=arm)
        flight = Flight()
        try:
            flight.begin()
            report, reactions, _ = flight.motion("reorientation", "--angle", degrees)
            turn, sigma = np.degrees([report.predicted[2], report.predicted_deviation[2]])
            seen, _ = turned(report, reactions)
            flight.motion("point_to_point", "--goal", *BENT)
            zero, reactions, _ = flight.motion("zero_reaction", "--direction", 1, 0, 0, 0)
            _, kept = turned(zero, reactions)
            there = np.degrees(reactions[-1].q)
            flight.motion("point_to_point", "--goal", *BENT)
            move, reactions, _ = flight.motion(
                "point_to_point", "--goal", *there, "--duration", zero.duration
            )
            _, straight = turned(move, reactions)
            flight.motion("point_to_point", "--goal", *BENT)
            _, _, truths = flight.motion("tip_path", "--by", *LINE)
        finally:
            flight.mover.destroy()
            flight.executor_.shutdown()
            flight.destroy_node()
            rclpy.shutdown()
    return (
        seed,
        turn,
        sigma,
        seen,
        (seen - turn) / sigma,
        np.degrees(zero.predicted_excursion),
        kept,
        straight,
        *off_line(load(CONFIG / "truth.yaml"), truths),
    )


COLUMNS = (
    *("seed", "turn predicted [deg]", "1 sigma", "measured", "[sigma]"),
    *("zero reaction predicted [deg]", "measured", "straight", "off line [mm]", "its end [mm]"),
)


def main():
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    degrees = float(sys.argv[2]) if len(sys.argv) > 2 else 30.0
    console, table = Console(width=160), Table(*COLUMNS)
    worst = 0.0
    for seed in range(1, seeds + 1):
        row = fly(seed, degrees, console.print)
        worst = max(worst, abs(row[4]))
        table.add_row(str(seed), *(f"{value:.3f}" for value in row[1:]))
        console.print(*(f"{value:.3f}" for value in row))
    console.print(table)
    return int(worst > 3.0)


if __name__ == "__main__":
    sys.exit(main())
