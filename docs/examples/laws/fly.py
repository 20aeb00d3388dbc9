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

from fss_arm_model.description import paper_arm
from fss_arm_ros.libraries import required_libraries
from fss_gnc.law import Inputs, Outputs
from fss_gnc.law.contract import LawError
from fss_gnc.law.forms import EXPECTED, Law, load
from fss_gnc.reference import pose_error
from fss_rehearsal.law_plant import LawPlant

START = (0.1, -0.05, 0.2, 0.6, -0.6, -0.6, 0.6)  # pose of the base [m, m, rad], joints [rad]
RATE = 50.0  # of the law [1/s]


@dataclass
class Step:
    """One step of a flight."""

    inputs: Inputs
    outputs: Outputs
    propellant: float  # used since the start [kg]

    @property
    def error(self) -> np.ndarray:
        """Error of the base's pose, (3,)."""
        return pose_error(self.inputs.base_pose, self.inputs.reference_pose)


def fly(law: Law, duration: float) -> Iterator[Step]:
    """Yield each step of a flight of some duration [s]."""
    plant = LawPlant(paper_arm(), START)
    for _ in range(round(duration * RATE)):
        inputs = plant.inputs(1.0 / RATE)
        outputs = law.step(inputs)
        plant.advance(outputs, 1.0 / RATE)
        yield Step(inputs, outputs, plant.plant.thrusters.propellant_used)
    law.terminate()


def main() -> int:
    """Fly a law and print a table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("law", help=EXPECTED)
    parser.add_argument("--duration", type=float, default=60.0, help="of the flight [s]")
    options = parser.parse_args()
    try:
        with required_libraries("fly.py"):
            law = load(options.law, paper_arm().n, 1.0 / RATE)
    except LawError as error:
        print(f"fly.py: {error}", file=sys.stderr)
        return 1
    print("time [s]  position error [mm]  heading error [deg]  propellant [g]")
    for k, step in enumerate(fly(law, options.duration)):
        if k % round(5.0 * RATE) == 0 or k == round(options.duration * RATE) - 1:
            away, turn = 1e3 * np.hypot(*step.error[:2]), round(degrees(step.error[2]), 2) + 0.0
            gas, time = 1e3 * step.propellant, step.inputs.time
            print(f"{time:8.1f}  {away:19.1f}  {turn:19.2f}  {gas:14.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
