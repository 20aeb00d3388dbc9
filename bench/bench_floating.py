"""Rotation of a floating base by arm motions: all nodes on the simulated test bed, default errors.

    . scripts/env.sh; python bench/bench_floating.py [SEEDS] [DEGREES]

For each seed of the sensor errors, config/cad.yaml is calibrated, kinematically and dynamically,
from thirteen rests and the moves between them (in one process). The nodes
use only the resulting description. They execute a reorientation, a zero-reaction motion, the
straight move between its two postures, and a motion of the end effector by 0.5 m along a line in
the world. Headings are from `base_reaction`; the line is measured on `sim/truth`. Exits with 1 if a
reorientation differs from its prediction by more than 3 sigma as given by `arm/motion`.
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
from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import BaseReaction
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import SENSOR
from fss_rehearsal.processes import Nodes

CONFIG = Path(__file__).parents[1] / "config"
BENT = [-50.0, 55.0, 45.0, 40.0]  # [deg]
LINE = [0.5 * np.cos(3.7), 0.5 * np.sin(3.7)]  # [m]
LONG_TIMEOUTS = {"timeout": 4.0, "watchdog": 6.0}  # for a busy computer
SETTLING_TIME = 1.0  # after a motion [s]


class Flight(Person):
    """Operator that records base_reaction."""

    def __init__(self):
        self.executor_ = SingleThreadedExecutor()
        super().__init__(self.until)
        self.executor_.add_node(self)
        self.reactions = []
        self.create_subscription(BaseReaction, "base_reaction", self.reactions.append, SENSOR)

    def until(self, _, condition, timeout=60.0):
        """Spin until the condition holds."""
        deadline = monotonic() + timeout
        while not condition():
            if monotonic() > deadline:
                raise TimeoutError(f"the condition did not hold within {timeout} s")
            self.executor_.spin_once(timeout_sec=0.02)

    def motion(self, kind, *arguments, **goal):
        """Execute a motion; return its report, and the reactions and truths until the arm rests."""
        result = self.execute(kind=kind, arguments=[str(message) for message in arguments], **goal)
        if not result.result.reached:
            raise RuntimeError(f"{kind}: {result.result.message}")
        report = result.result.report
        start = stamp_ns(report.header.stamp)
        end = start + round((report.duration + SETTLING_TIME) * SECOND)

        def stamp(message):
            return stamp_ns(message.header.stamp)

        self.until(self, lambda: stamp(self.reactions[-1]) > end and stamp(self.truths[-1]) > end)
        recorded = [
            [message for message in messages if start <= stamp(message) <= end]
            for messages in (self.reactions, self.truths)
        ]
        self.reactions.clear()
        self.truths.clear()
        return report, *recorded


def base_rotation(report, reactions):
    """Return the final and the largest rotation of the base [deg]."""
    duration = report.duration + 0.5 * SETTLING_TIME
    settled_at = stamp_ns(report.header.stamp) + round(duration * SECOND)
    heading = np.degrees([message.measured[2] for message in reactions])
    settled = [stamp_ns(message.header.stamp) > settled_at for message in reactions]
    return heading[settled].mean() - heading[0], np.abs(heading - heading[0]).max()


def line_errors(arm, truths):
    """Return the largest distance of the true end effector from the line, and from its end [mm]."""
    tip = tip_pose(arm.vector(), np.array([message.q for message in truths]))[:, :2]
    from_start, along = tip - tip[0], np.array(LINE) / np.linalg.norm(LINE)
    across = from_start @ [-along[1], along[0]]
    return 1e3 * np.abs(across).max(), 1e3 * np.linalg.norm(from_start[-1] - LINE)


def calibrated_description(seed):
    """Return the description calibrated from a seed's experiment."""
    run = Rehearsal(CONFIG, seed=seed, preset="default")
    run.run()
    found = calibrate(run.observations, run.guess, KinematicSettings(), run.finder.streams())
    kinematic, streams = from_yaml(found.description), run.maneuver_finder.streams()
    return calibrate_dynamics(run.maneuvers, kinematic, DYNAMIC, streams).description


def fly(seed, degrees, say):
    """Run one seed; return its row of the table."""
    logs = Path(mkdtemp(prefix="bench_floating_"))
    arm = logs / "arm.yaml"
    arm.write_text(calibrated_description(seed))
    rclpy.init()
    with Nodes(logs, say, OWN) as nodes:
        nodes.start(
            "testbed",
            "fss_sim",
            "testbed",
            arm=CONFIG / "truth.yaml",
            seed=seed,
            ports=OWN.ports(4),
            truth_rate=50.0,
        )
        nodes.start("links", "fss_arm_driver", "link", urls=OWN.urls(4), arm=arm, **LONG_TIMEOUTS)
        nodes.start("arm", "fss_arm_driver", "arm", arm=arm, time_to_live=4.0)
        nodes.start("base_reaction", "fss_arm_view", "base_reaction", arm=arm)
        nodes.start("motion", "fss_arm_motion", "motion", arm=arm)
        flight = Flight()
        try:
            flight.begin()
            report, reactions, _ = flight.motion("reorientation", "--angle", degrees)
            turn, sigma = np.degrees([report.predicted[2], report.predicted_deviation[2]])
            measured, _ = base_rotation(report, reactions)
            flight.motion("point_to_point", "--goal", *BENT)
            zero, reactions, _ = flight.motion("zero_reaction", "--direction", 1, 0, 0, 0)
            _, rotation_zero = base_rotation(zero, reactions)
            end_posture = np.degrees(reactions[-1].q)
            flight.motion("point_to_point", "--goal", *BENT)
            move, reactions, _ = flight.motion(
                "point_to_point", "--goal", *end_posture, "--duration", zero.duration
            )
            _, rotation_straight = base_rotation(move, reactions)
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
        measured,
        (measured - turn) / sigma,
        np.degrees(zero.predicted_excursion),
        rotation_zero,
        rotation_straight,
        *line_errors(load(CONFIG / "truth.yaml"), truths),
    )


COLUMNS = (
    *("seed", "turn predicted [deg]", "1 sigma", "measured", "[sigma]"),
    *("zero reaction predicted [deg]", "measured", "straight", "line error [mm]", "at end [mm]"),
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
