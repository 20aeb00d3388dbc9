"""Observations of a random arm with its description, and typical errors of a laboratory."""

from dataclasses import replace

import numpy as np

from fss_arm_calib.kinematic.early_cause import early_cause
from fss_arm_calib.kinematic.problem import FULL, KinematicProblem
from fss_arm_model.description import Arm, Base, Drive, Link
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.planar import inverse

NOISE = 1e-3, 1e-3, 2e-3  # of an observed pose [m, m, rad]
LENGTH_ERROR, ANGLE_ERROR = 0.01, 0.07  # largest errors of the description [m], [rad]


def arm(n: int, rng: np.random.Generator) -> Arm:
    links = [
        Link(
            a=rng.uniform(0.25, 0.4),
            theta_0=rng.uniform(-0.1, 0.1) if i else 0.0,
            mass=2.0,
            b=0.15,
            inertia=0.03,
        )
        for i in range(n)
    ]
    base = Base(10.0, 0.3, mount=(0.2, 0.02, rng.uniform(-0.3, 0.3)))
    return Arm("arm", base, tuple(links))


def described(truth: Arm, rng: np.random.Generator) -> Arm:
    """Return the description that a laboratory has before it calibrates."""
    links = [
        replace(
            link,
            a=link.a + rng.uniform(-LENGTH_ERROR, LENGTH_ERROR),
            theta_0=link.theta_0 + (rng.uniform(-ANGLE_ERROR, ANGLE_ERROR) if i else 0.0),
        )
        for i, link in enumerate(truth.links)
    ]
    return replace(truth, links=tuple(links))


def observed(n: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, Arm]:
    """Return readings and poses of `count` postures, and the description."""
    rng = np.random.default_rng(seed)
    truth = arm(n, rng)
    q = rng.uniform(-1.4, 1.4, (count, n))
    tip = tip_in_base(truth.vector(), q) + rng.standard_normal((count, 3)) * NOISE
    return q, tip, described(truth, rng)


def cause_of(q: np.ndarray, tip: np.ndarray, guess: Arm) -> str:
    return early_cause(KinematicProblem(q, tip, guess, FULL))


def swapped(q: np.ndarray, i: int, j: int) -> np.ndarray:
    order = np.arange(q.shape[1])
    order[[i, j]] = j, i
    return q[:, order]


def counts(q: np.ndarray) -> np.ndarray:
    drive = Drive()
    return np.round(q * drive.direction * drive.counts_per_turn / (2.0 * np.pi))


def with_sign_of_joint_2(q: np.ndarray) -> np.ndarray:
    return q * np.where(np.arange(q.shape[1]) == 1, -1.0, 1.0)


ERRORS = {
    "joint_2 with the wrong sign? reversed": lambda q, tip: (with_sign_of_joint_2(q), tip),
    "all joints with the wrong sign? reversed": lambda q, tip: (-q, tip),
    "joint_1 and joint_2 swapped? swapped back": lambda q, tip: (swapped(q, 0, 1), tip),
    "joints counted from the tip? in reverse order": lambda q, tip: (q[:, ::-1], tip),
    "base and end effector are swapped? swapped back": lambda q, tip: (q, inverse(tip)),
    "poses mirrored? with y and headings reversed": lambda q, tip: (q, tip * [1, -1, -1]),
    "end effector's subject rotated": lambda q, tip: (q, tip + np.array([0.0, 0.0, np.pi / 2.0])),
    "joints in degrees? converted to radians": lambda q, tip: (np.degrees(q), tip),
    "joints in counts? converted to radians": lambda q, tip: (counts(q), tip),
    "positions in millimeters? with a factor of 0.001": lambda q, tip: (q, tip * [1e3, 1e3, 1]),
}
