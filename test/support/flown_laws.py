"""The laws of faulty_laws.py; they open valves and move joints for three seconds, then fail."""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))

import faulty_laws

faulty_laws.GOOD_STEPS = 150
GAIN, HALF_PERIOD = 20.0, 25  # of the commands; steps with one sign


def flown(name):
    """Return a law with larger commands, whose sign changes."""

    class Flown(getattr(faulty_laws, name)):
        def step(self, inputs):
            outputs = super().step(inputs)
            sign = 1.0 if self.steps // HALF_PERIOD % 2 else -1.0
            np.multiply(outputs.wrench, sign * GAIN, out=outputs.wrench)
            np.multiply(outputs.joint_velocities, sign, out=outputs.joint_velocities)
            return outputs

    return Flown


Good, Exceptional, Segmentation = flown("Good"), flown("Exceptional"), flown("Segmentation")
Endless, Leak, NotANumber = flown("Endless"), flown("Leak"), flown("NotANumber")
