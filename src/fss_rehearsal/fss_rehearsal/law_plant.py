"""The simulated plant behind the contract of a control law: commands in, true states out.

usage: python -m fss_rehearsal.law_plant ARM FD

An FMU of the plant (scripts/fmu.sh) runs this; it sends its time step and its block to FD.
"""

import socket
import sys
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.integration import STEP
from fss_base_driver.allocation import Allocation
from fss_gnc.law.contract import (
    MAX_JOINTS,
    STRUCTURES,
    VALVES,
    Inputs,
    Outputs,
    from_record,
    to_record,
)
from fss_sim.plant.drives import MODE_CURRENT, MODE_POSITION, MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand

ALLOCATION_PERIOD = 0.1  # of the valves for a wrench [s]
MAX_SPEED = 0.5  # of a joint that moves to a position [rad/s]
#: Memory of an FMU: its time, the law's commands, the states, and the initial pose and angles.
BLOCK = np.dtype(
    [
        ("time", "f8"), ("commands", STRUCTURES[Outputs]), ("states", STRUCTURES[Inputs]),
        ("start_pose", "f8", 3), ("start_joint_angles", "f8", MAX_JOINTS),
    ],
    align=True,
)  # fmt: skip


class LawPlant:
    """Plant that a control law commands, without delays or errors of sensors.

    Args:
        arm: its description.
        start: (3 + n,) pose of the base [m, m, rad] and angles of the joints [rad].
    """

    def __init__(self, arm: Arm, start: npt.ArrayLike) -> None:
        self.plant, self.step = Plant(arm, start), 0  # in steps of the drives
        self._allocation_time = 0
        thrusters = self.plant.thrusters
        self._allocation = Allocation(
            thrusters.layout, ALLOCATION_PERIOD, thrusters.propulsion.minimum_on_time
        )

    def inputs(self, period: float) -> Inputs:
        """Return the present inputs of a law; its reference is at rest at the origin."""
        plant, tank, closed = self.plant, self.plant.thrusters, np.zeros(VALVES, dtype=bool)
        return Inputs(
            joints=plant.n, time=self.step * STEP, period=period, base_pose=plant.q[:3].copy(),
            base_twist=plant.qd[:3].copy(), base_covariance=np.zeros(36), base_age=0.0,
            joint_angles=plant.q[3:].copy(), joint_rates=plant.qd[3:].copy(),
            reference_pose=np.zeros(3), reference_twist=np.zeros(3),
            reference_acceleration=np.zeros(3), valves_armed=True,
            joints_armed=np.ones(plant.n, dtype=bool), valves_stuck_open=closed,
            valves_stuck_closed=closed, propellant=tank.capacity - tank.propellant_used,
        )  # fmt: skip

    def advance(self, outputs: Outputs, period: float) -> None:
        """Follow the commands for a time [s].

        Raises:
            ValueError: a command is not finite or has another size than the contract states, or the
                time is not a multiple of STEP.
        """
        to_record(outputs, self.plant.n)  # checks the sizes
        outputs.require_finite()
        steps = round(period / STEP)
        if steps < 1 or abs(steps * STEP - period) > 1e-9:
            raise ValueError(f"the time step is {period} s, expected a multiple of {STEP} s")
        if outputs.wrench is not None and self.step >= self._allocation_time:
            self.plant.thrust(self._allocation.on_times(outputs.wrench).tolist())
            self._allocation_time = self.step + round(ALLOCATION_PERIOD / STEP)
        if outputs.valve_on_times is not None:
            self.plant.thrust(outputs.valve_on_times.tolist())
        for i, demand in demands(outputs):
            self.plant.command(i, demand)
        self.plant.advance(period)
        self.step += steps


def demands(outputs: Outputs) -> Iterator[tuple[int, Demand]]:
    """Yield number from 0 and command of each joint that is commanded."""
    commands = {
        MODE_POSITION: outputs.joint_positions,
        MODE_VELOCITY: outputs.joint_velocities,
        MODE_CURRENT: outputs.joint_currents,
    }
    for mode, values in commands.items():
        for i, value in enumerate([] if values is None else values.tolist()):
            speed = abs(value) if mode == MODE_VELOCITY else MAX_SPEED
            yield i, Demand(int(mode), value, speed)


def main(description: str, fd: str) -> None:
    """Advance the plant at each message, until the FMU ends."""
    arm, channel, plant = described(description), socket.socket(fileno=int(fd)), None
    while data := channel.recv(8 + BLOCK.itemsize):
        period, block = np.frombuffer(data[:8])[0], np.frombuffer(data[8:], BLOCK)[0].copy()
        if plant is None:
            start = block["start_pose"], block["start_joint_angles"][: arm.n]
            plant = LawPlant(arm, np.concatenate(start))
        else:
            plant.advance(from_record(Outputs, block["commands"], arm.n), float(period))
        block["states"] = to_record(plant.inputs(float(period)), arm.n)
        channel.send(block.tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
