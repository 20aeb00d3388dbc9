"""NMPC law beside the shipped control: reaches of the arm with the base held, and a base move.

Both fly the plant of the paper's arm in stepped time, at 50 Hz and with true states, and follow the
path of guidance. The shipped control compensates the arm's planned accelerations.

    . scripts/env.sh; python bench/bench_nmpc.py      # needs CasADi
"""

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from fss_arm_model.arrays import Floats
from fss_arm_model.description import paper_arm
from fss_gnc.control.pose import PoseControl
from fss_gnc.guidance.limits import min_duration
from fss_gnc.guidance.settings import GuidanceSettings
from fss_gnc.law import Inputs, Outputs
from fss_gnc.law.forms import Law, load
from fss_gnc.reference import Path as BasePath
from fss_gnc.reference import Reference, pose_error
from fss_rehearsal.law_plant import LawPlant

LAWS = Path(__file__).resolve().parents[1] / "docs/examples/laws"
RATE = 50.0  # [1/s]
DURATION = 60.0  # of a flight [s]
ANGLES, GOAL = np.array([0.6, -0.6, -0.6, 0.6]), np.array([-0.6, 0.6, 0.6, -0.6])  # [rad]
ACCELERATION = 0.2  # of a joint that reaches [rad/s^2]
MAX_WRENCH = np.array([0.3, 0.3, 0.065])  # as of the NMPC law [N, N, N m]
CASES = {  # initial pose of the base, speed of the joints [rad/s]
    "reach at 0.15 rad/s": ((0.0, 0.0, 0.0), 0.15),
    "reach at 0.3 rad/s": ((0.0, 0.0, 0.0), 0.3),
    "move by 0.5 m": ((0.4, -0.3, 0.0), 0.0),
}
ARRIVED = 0.02  # error of the position [m]


class Shipped:
    """The control of `control`, with joints on trapezoidal profiles."""

    path = __file__

    def __init__(self, speed: float) -> None:
        self.control, self.speed = PoseControl(paper_arm()), speed

    def rates(self, t: float) -> Floats:
        """Return the rates of the joints at a time [s]."""
        if not self.speed:
            return np.zeros(4)
        rise = self.speed / ACCELERATION
        end = abs(GOAL[0] - ANGLES[0]) / self.speed + rise
        rate = np.clip(ACCELERATION * min(t, end - t), 0.0, self.speed)
        return np.sign(GOAL - ANGLES) * rate

    def step(self, inputs: Inputs) -> Outputs:
        """Return wrench and rates."""
        t, period = inputs.time, inputs.period
        accelerations = (self.rates(t + period) - self.rates(t)) / period
        q = np.concatenate([inputs.base_pose, inputs.joint_angles])
        qd = np.concatenate([inputs.base_twist, inputs.joint_rates])
        reference = Reference(
            inputs.reference_pose, inputs.reference_twist, inputs.reference_acceleration
        )
        wrench = self.control.wrench(q, qd, reference, period, accelerations)
        return Outputs(
            wrench=np.clip(wrench, -MAX_WRENCH, MAX_WRENCH), joint_velocities=self.rates(t)
        )

    def terminate(self) -> None:
        """End."""


def fly(law: Law, start: Floats) -> list[str]:
    """Return a row of the table: errors, time, propellant and processor time of a flight."""
    plant = LawPlant(paper_arm(), np.concatenate([start, ANGLES]))
    initial = Reference.at_rest(start)
    duration = max(min_duration(GuidanceSettings(), initial, np.zeros(3)), 1.0)
    path, errors, times = BasePath.between(initial, np.zeros(3), 0.0, duration), [], []
    for k in range(round(DURATION * RATE)):
        desired = path.at(k / RATE)
        inputs = replace(
            plant.inputs(1.0 / RATE),
            reference_pose=desired.pose,
            reference_twist=desired.twist,
            reference_acceleration=desired.acceleration,
        )
        errors.append(pose_error(inputs.base_pose, desired.pose))
        begin = time.thread_time()
        outputs = law.step(inputs)
        times.append(time.thread_time() - begin)
        plant.advance(outputs, 1.0 / RATE)
    law.terminate()
    offsets = np.hypot(*np.transpose(errors)[:2])
    turns = np.degrees(np.abs(np.transpose(errors)[2]))
    late = np.flatnonzero(offsets > ARRIVED)
    last = round(10.0 * RATE)
    return [
        f"{1e3 * offsets.max():.0f}, {turns.max():.1f}",
        f"{1e3 * offsets[-last:].max():.1f}, {turns[-last:].max():.2f}",
        f"{(late[-1] + 1) / RATE if len(late) else 0.0:.1f}",
        f"{1e3 * plant.plant.thrusters.propellant_used:.0f}",
        f"{1e3 * np.percentile(times, 99):.1f}",
    ]


def compiled(folder: Path) -> Callable[[float], str]:
    """Generate the solver; return a function that compiles the law for a speed [rad/s]."""
    subprocess.run([sys.executable, LAWS / "nmpc.py"], cwd=folder, check=True)

    def compile_law(speed: float) -> str:
        library = f"{folder}/nmpc_{speed}.so"
        options = f"-O2 -ffp-contract=off -fPIC -shared -DSPEED={speed} -I{LAWS} -o {library}"
        sources = [LAWS / "nmpc.c", folder / "nmpc_solver.c"]
        subprocess.run(["cc", *options.split(), *sources, "-lm"], check=True)
        return library

    return compile_law


def main() -> int:
    """Fly all cases with both."""
    table = Table(
        *("case", "law", "largest [mm, deg]", "last 10 s [mm, deg]", "within 20 mm [s]"),
        *("gas [g]", "CPU p99 [ms]"),
    )
    with TemporaryDirectory() as folder:
        law_of = compiled(Path(folder))
        for case, (pose, speed) in CASES.items():
            start = np.array(pose)
            table.add_row(case, "shipped", *fly(Shipped(speed), start))
            law = load(law_of(speed), len(ANGLES), 1.0 / RATE)
            table.add_row(case, "NMPC", *fly(law, start))
    Console(width=110).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
