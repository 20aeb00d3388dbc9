"""Control laws that command a wrench and joint rates, and fail after some steps."""

import os
import signal
import time

import numpy as np

from fss_gnc.law import Outputs

GOOD_STEPS = 10


class Good:
    """A law without a fault."""

    def __init__(self, joints, period):
        self.joints, self.steps = joints, 0

    def step(self, inputs):
        self.steps += 1
        if self.steps > GOOD_STEPS:
            self.fail()
        return Outputs(wrench=np.full(3, 0.01), joint_velocities=np.full(self.joints, 0.02))

    def fail(self):
        pass


class Closing(Good):
    """A law that always wants the gripper closed."""

    def step(self, inputs):
        return Outputs(wrench=np.zeros(3), gripper_closed=True)


class Exceptional(Good):
    def fail(self):
        raise ZeroDivisionError("of the law")


class Segmentation(Good):
    def fail(self):
        os.kill(os.getpid(), signal.SIGSEGV)


class Endless(Good):
    def fail(self):
        while True:
            pass


class Leak(Good):
    def fail(self):
        self.kept = [bytearray(16 << 20) for _ in range(128)]  # 2 GB


class Late(Good):
    def fail(self):
        if self.steps == GOOD_STEPS + 1:
            time.sleep(0.2)  # ten periods of 50 Hz


class Exiting(Good):
    def fail(self):
        os._exit(3)


class NotANumber(Good):
    def step(self, inputs):
        outputs = super().step(inputs)
        if self.steps > GOOD_STEPS:
            outputs.wrench[1] = np.nan
        return outputs


class Short(Good):
    def step(self, inputs):
        return Outputs(joint_velocities=np.zeros(2))


class Broken:
    def __init__(self, joints, period):
        raise ValueError("no\ngains")


class Singular(Good):
    def fail(self):
        np.linalg.inv(np.zeros((2, 2)))


class Piping(Good):
    def fail(self):
        raise BrokenPipeError("of the law")
