"""Maneuvers of a floating arm, simulated: moves between postures, poses seen before and after."""

from dataclasses import replace

import numpy as np

from fss_arm_calib.dynamic.knowledge import Knowledge
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_model import base_motion, joint_path
from fss_arm_model.choice import Choice
from fss_arm_model.description import Link, paper_arm
from fss_arm_model.parameters import to_vector

ARM = paper_arm()
NAMES = "b_i I_i I_0 com_0"
MOMENTUM = np.array([0.2, 0.2, 0.05])  # 1 sigma of it at a start
TILT = 0.0017  # of 0.01 degrees [m/s^2]
POSITION, HEADING, RATE = 0.001, np.radians(0.5), 10.0  # of VICON, errors fresh so often a second


def arm_of(n):
    """An arm of n unlike links."""
    links = [
        Link(a=0.3 + 0.02 * i, theta_0=0.05 * i, mass=2.0 + 0.3 * i, inertia=0.03, b=0.13)
        for i in range(n)
    ]
    return replace(ARM, links=tuple(links))


def moves(postures, speed=1.0, acceleration=2.0):
    """Law and edges of moves along straight lines in joint space, from rest to rest."""
    postures = np.asarray(postures)
    way = np.abs(np.diff(postures, axis=0)).max(axis=1)
    edges = np.concatenate([[0.0], np.cumsum(1.5 * way / speed + speed / acceleration)])

    def law(t):
        k = np.clip(np.searchsorted(edges, t, "right") - 1, 0, len(way) - 1)
        length = (edges[k + 1] - edges[k])[:, None]
        x = np.clip((t - edges[k])[:, None] / length, 0.0, 1.0)
        step = postures[k + 1] - postures[k]
        return postures[k] + step * x**2 * (3.0 - 2.0 * x), step * 6.0 * x * (1.0 - x) / length

    return law, edges


def maneuver(postures, rest=2.0, marks=4):
    """A path with so many marks in the rests before and after."""
    law, edges = moves(postures)
    within = rest / marks * (np.arange(marks) + 0.5)
    return joint_path.path(law, edges, [*(within - rest), *(edges[-1] + within)])


def several(count, n=4, seed=0, rest=2.0):
    """Maneuvers of all joints, each to two more postures."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], (count, 3, n))
    postures = signs * rng.uniform(0.6, 1.5, (count, 3, n))
    return joint_path.stack([maneuver(q, rest) for q in postures])


def single_joint():
    """As the paper's: 8 maneuvers, each of one joint through +-60 degrees, seen at both ends."""
    rest = np.radians([[40, -70, 60, -60], [-30, 60, -70, 50]])
    paths = []
    for q, joint in np.ndindex(2, 4):
        ends = np.array([rest[q], rest[q]])
        ends[:, joint] = np.radians([-60, 60])
        law, edges = moves(ends if q else ends[::-1])
        paths.append(joint_path.path(law, edges, [edges[0], edges[-1]]))
    return joint_path.stack(paths)


def problem(path, arm=ARM, words=NAMES, knowledge=None, heading_only=False, **known):
    """A problem whose poses are still to come: of links, b and I are not known beforehand."""
    knowledge, choice = knowledge or Knowledge(), Choice.of(words, arm.n)
    deviations = knowledge.deviations(arm)
    prior = choice.mean(deviations)
    free = [name[0] in "bI" and name != "I_0" for name in choice.names]
    count, marks = path.marks.shape[:2]
    looks = max(1.0, 4.0 * RATE / marks) if marks > 2 else 1.0
    sigma = np.empty((count, marks, 3))
    sigma[..., :2] = np.inf if heading_only else POSITION / np.sqrt(looks)
    sigma[..., 2] = HEADING / np.sqrt(looks)
    values = {
        "path": path,
        "poses": np.zeros_like(sigma),
        "sigma": sigma,
        "arm": arm,
        "choice": choice,
        "prior": np.where(free, np.inf, prior),
        "assumed": np.diag(deviations**2),
        "momentum": MOMENTUM,
        "tilt": TILT,
    }
    return DynamicProblem(**{**values, **known})


def observe(problem, vector, states, rng=None):
    """The problem with the poses that an arm, Arm.vector(), and states (M, 8) give."""
    poses = base_motion.base_poses(vector, problem.path, states)
    if rng is not None:
        seen = np.isfinite(problem.sigma)
        poses = poses + np.where(seen, problem.sigma, 0.0) * rng.standard_normal(poses.shape)
    return replace(problem, poses=poses)


def draw(problem, rng):
    """A truth that the problem's knowledge is true of: all parameters' errors, and states."""
    n = problem.arm.n
    errors = rng.standard_normal(5 * n + 6) * np.sqrt(np.diag(problem.assumed))
    chosen = problem.choice.indices
    prior = problem.choice.basis @ np.where(np.isfinite(problem.prior), problem.prior, 0.0)
    errors[chosen] = prior[chosen] * rng.standard_normal(len(chosen))
    states = np.zeros((len(problem.poses), 8))
    states[:, :3] = rng.uniform(-1.0, 1.0, (len(states), 3)) * [0.5, 0.5, 3.0]
    states[:, 3:6] = problem.momentum * rng.standard_normal((len(states), 3))
    states[:, 6:] = problem.tilt * rng.standard_normal(2)
    return errors, problem.arm.vector() + to_vector(n) @ errors, states
