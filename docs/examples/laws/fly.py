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
from fss_base_driver.allocation import Allocation
from fss_gnc.law import Inputs, Outputs
from fss_gnc.law.forms import Law, LawError, load
from fss_gnc.reference import pose_error
from fss_sim.plant.drives import MODE_CURRENT, MODE_POSITION, MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand

START = (0.1, -0.05, 0.2, 0.6, -0.6, -0.6, 0.6)  # pose of the base [m, m, rad], joints [rad]
RATE = 50.0  # of the law [1/s]
ALLOCATION_STEPS = 5  # of the law, from one allocation of a wrench to the next
MAX_SPEED = 0.5  # of a joint that moves to a position [rad/s]
CLOSED = (False,) * 8


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
    plant = Plant(paper_arm(), START)
    thrusters = plant.thrusters
    allocation = Allocation(
        thrusters.layout, ALLOCATION_STEPS / RATE, thrusters.propulsion.minimum_on_time
    )
    for k in range(round(duration * RATE)):
        inputs = true_inputs(plant, k / RATE)
        outputs = law.step(inputs)
        outputs.require_finite()
        if outputs.wrench is not None and k % ALLOCATION_STEPS == 0:
            plant.thrust(allocation.on_times(outputs.wrench))
        if outputs.valve_on_times is not None:
            plant.thrust(outputs.valve_on_times)
        for i, demand in demands(outputs):
            plant.command(i, demand)
        plant.advance(1.0 / RATE)
        yield Step(inputs, outputs, thrusters.propellant_used)
    law.terminate()


def true_inputs(plant: Plant, time: float) -> Inputs:
    """Return the inputs of a law at a time [s], without errors of sensors."""
    return Inputs(
        joints=plant.n, time=time, period=1.0 / RATE, base_pose=plant.q[:3].copy(),
        base_twist=plant.qd[:3].copy(), base_covariance=np.zeros(36), base_age=0.0,
        joint_angles=plant.q[3:].copy(), joint_rates=plant.qd[3:].copy(),
        reference_pose=np.zeros(3), reference_twist=np.zeros(3),
        reference_acceleration=np.zeros(3), valves_armed=True,
        joints_armed=np.ones(plant.n, dtype=bool), valves_stuck_open=np.array(CLOSED),
        valves_stuck_closed=np.array(CLOSED), propellant=0.1 - plant.thrusters.propellant_used,
    )  # fmt: skip


def demands(outputs: Outputs) -> Iterator[tuple[int, Demand]]:
    """Yield number from 0 and command of each joint that is commanded."""
    for mode, values in (
        (MODE_POSITION, outputs.joint_positions), (MODE_VELOCITY, outputs.joint_velocities),
        (MODE_CURRENT, outputs.joint_currents),
    ):  # fmt: skip
        for i, value in enumerate([] if values is None else values.tolist()):
            speed = abs(value) if mode == MODE_VELOCITY else MAX_SPEED
            yield i, Demand(mode, value, speed)


def main() -> int:
    """Fly a law and print a table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("law", help="FILE.py:CLASS, MODULE:CLASS or LIBRARY.so")
    parser.add_argument("--duration", type=float, default=60.0, help="of the flight [s]")
    options = parser.parse_args()
    try:
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
