"""Fly a law in the simulated plant, without ROS and faster than real time, and print the errors.

The base starts away from its reference and at rest; the law has to take it there and hold it. Its
inputs are the true states, without noise or delay.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees

import numpy as np

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_ros.command_line import in_words
from fss_arm_ros.libraries import required_libraries
from fss_gnc.law import Inputs, Outputs
from fss_gnc.law.contract import LawError
from fss_gnc.law.forms import EXPECTED, Law, load
from fss_gnc.reference import pose_error
from fss_rehearsal.law_plant import LawPlant

START_POSE = (0.1, -0.05, 0.2)  # of the base [m, m, rad]
START_ANGLE = 0.6  # of the joints; every second pair is negative [rad]
RATE = 50.0  # of the law [1/s]


@dataclass
class Step:
    """One step of a flight."""

    inputs: Inputs
    outputs: Outputs
    propellant: float  # used since the start [kg]
    capacity: float  # of the tank [kg]

    @property
    def error(self) -> np.ndarray:
        """Error of the base's pose, (3,)."""
        return pose_error(self.inputs.base_pose, self.inputs.reference_pose)


def start(arm: Arm) -> np.ndarray:
    """Return the state at the start of a flight, (3 + n,)."""
    angles = [-START_ANGLE if i % 4 in (1, 2) else START_ANGLE for i in range(arm.n)]
    return np.array([*START_POSE, *angles])


def fly(law: Law, arm: Arm, duration: float) -> Iterator[Step]:
    """Yield each step of a flight of some duration [s]."""
    plant = LawPlant(arm, start(arm))
    for _ in range(round(duration * RATE)):
        inputs = plant.inputs(1.0 / RATE)
        outputs = law.step(inputs)
        try:
            plant.advance(outputs, 1.0 / RATE)
        except ValueError as error:
            raise LawError(f"the law's commands: {error}") from None
        tank = plant.plant.thrusters
        yield Step(inputs, outputs, tank.propellant_used, tank.capacity)
    law.terminate()


def main() -> int:
    """Fly a law and print a table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("law", help=EXPECTED)
    parser.add_argument("--arm", default="", help="paper (default), cad, truth or a file")
    parser.add_argument("--duration", type=float, default=60.0, help="of the flight [s]")
    options = parser.parse_args()
    try:
        arm = described(options.arm)
    except (ValueError, OSError) as error:
        parser.error(in_words(error))
    try:
        with required_libraries("fly.py"):
            show(fly(load(options.law, arm.n, 1.0 / RATE), arm, options.duration))
    except LawError as error:
        print(f"fly.py: {error}", file=sys.stderr)
        return 1
    return 0


def show(steps: Iterator[Step]) -> None:
    """Print a line every 5 s, and the last step."""
    print("time [s]  position error [mm]  heading error [deg]  propellant [g]")
    every = round(5.0 * RATE)
    dry = False
    for k, step in enumerate(steps):
        if k % every == 0:
            print(line(step))
        if step.propellant >= step.capacity and not dry:
            dry = True
            print(f"the tank is empty after {step.inputs.time:.1f} s: its valves give no thrust")
    if k % every:
        print(line(step))


def line(step: Step) -> str:
    """Return time, errors and propellant of a step."""
    away, turn = 1e3 * np.hypot(*step.error[:2]), round(degrees(step.error[2]), 2) + 0.0
    return f"{step.inputs.time:8.1f}  {away:19.1f}  {turn:19.2f}  {1e3 * step.propellant:14.3f}"


if __name__ == "__main__":
    sys.exit(main())
