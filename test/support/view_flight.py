"""Simulated flight: an arm that moves with the drives' profile, on a floating base."""

from functools import cache
from math import radians

import numpy as np

from fss_arm_model.description import paper_arm
from fss_arm_model.momentum import momentum

STEP = 0.001  # [s]


def trapezoid(t, begin, angle, rate=0.5, acceleration=1.0):
    """Angle, rate and acceleration of a servo drive's profile."""
    ramp, sign = rate / acceleration, np.sign(angle)
    cruise = abs(angle) / rate - ramp
    u = t - begin
    edges = [0.0, ramp, ramp + cruise, 2 * ramp + cruise]
    qdd = (
        sign
        * acceleration
        * ((u >= edges[0]) * (u < edges[1]) * 1.0 - (u >= edges[2]) * (u < edges[3]) * 1.0)
    )
    qd = sign * acceleration * (np.clip(u, 0, ramp) - (np.clip(u, edges[2], edges[3]) - edges[2]))
    q = sign * (
        0.5 * acceleration * np.clip(u, 0, ramp) ** 2
        + rate * (np.clip(u, edges[1], edges[2]) - ramp)
        + rate * (np.clip(u, edges[2], edges[3]) - edges[2])
        - 0.5 * acceleration * (np.clip(u, edges[2], edges[3]) - edges[2]) ** 2
    )
    return q, qd, qdd


class Flight:
    """Joints that follow trapezoidal profiles, and a floating base with an initial twist."""

    def __init__(self, arm, twist=(0.0, 0.0, 0.0), end=6.0):
        p, n = arm.vector(), arm.n
        self.t = np.arange(0.0, end, STEP)
        angles = [radians(60), -radians(45), radians(30), -radians(20)]

        def laws(t):
            joints = [trapezoid(t, 2.0 + 0.1 * k, angles[k % 4]) for k in range(n)]
            return (np.array(part).T for part in zip(*joints, strict=True))

        self.q, self.qd, self.qdd = laws(self.t)
        half_q, half_qd, _ = laws(self.t + STEP / 2)
        state = np.concatenate([np.zeros(3), self.q[0]])
        rate = np.concatenate([twist, self.qd[0]])
        initial = momentum(p, state, rate)
        self.pose, self.twist = np.empty((2, len(self.t), 3))
        pose = np.zeros(3)

        def twist_at(pose, q, qd):
            # The twist that conserves the momentum.
            x = np.concatenate([pose, q])
            rates = np.concatenate([np.eye(3, 3 + n), [[0.0, 0.0, 0.0, *qd]]])
            *by_twist, joint_part = momentum(p, x, rates)
            return np.linalg.solve(np.transpose(by_twist), initial - joint_part)

        for k in range(len(self.t)):
            self.pose[k] = pose
            self.twist[k] = twist_at(pose, self.q[k], self.qd[k])
            if k + 1 < len(self.t):
                a = self.twist[k]
                b = twist_at(pose + STEP / 2 * a, half_q[k], half_qd[k])
                c = twist_at(pose + STEP / 2 * b, half_q[k], half_qd[k])
                d = twist_at(pose + STEP * c, self.q[k + 1], self.qd[k + 1])
                pose = pose + STEP / 6 * (a + 2 * b + 2 * c + d)
        self.momentum = initial

    def index(self, t):
        return round(t * 1e-9 / STEP)


@cache
def paper_flight():
    """The paper's arm, its base adrift; made once for all tests of a process."""
    return Flight(paper_arm(), (0.01, -0.02, radians(0.5)))
