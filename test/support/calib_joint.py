"""Sessions of rests, maneuvers and drifts of one simulated arm, and what is true of them."""

from dataclasses import replace
from math import radians
from typing import NamedTuple

import numpy as np
from calib_maneuvers import moves
from calib_rests import observations

from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import problem_of as dynamic_problem
from fss_arm_calib.dynamic.solve import solve as solve_dynamics
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import problem_of as kinematic_problem
from fss_arm_calib.kinematic.solve import solve as fit_kinematics
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_model import base_motion, joint_path
from fss_arm_model.description import Arm, Known, paper_arm
from fss_arm_model.drifting import drift, single_body
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.layout import kinematic_index
from fss_arm_model.parameters import parameter_names, values, with_values
from fss_arm_model.planar import wrap
from fss_arm_model.units import GRAVITY, SECOND

ARM = paper_arm()
BIN, FRAMES = 0.5, 50
LOOK = 0.1  # of a pose on the base's way [s]
PERIOD = 0.2  # of telemetry [s]
REST = 2.0  # before and after a maneuver [s]

# What the data are drawn by, and judged by: a laboratory that sees its arm well.
CAMERAS = {"position_deviation": 0.0005, "heading_deviation": radians(0.1), "fresh_rate": 100.0}
KINEMATIC = KinematicSettings(
    parametrization="full", position_deviation=0.001, heading_deviation=radians(0.1)
)
DYNAMIC = DynamicSettings(
    momentum_deviation=0.1, spin_deviation=0.02, tilt_deviation=radians(0.005), **CAMERAS
)
DRIFT = DriftSettings(torque_deviation=0.002, twist_deviation=0.003, drag_deviation=0.02, **CAMERAS)
SETTINGS = {"kinematic": KINEMATIC, "dynamic": DYNAMIC, "drift": DRIFT}
SURROUNDINGS = np.array(
    [
        *[GRAVITY * DYNAMIC.tilt_deviation] * 2,
        DRIFT.torque_deviation,
        DRIFT.twist_deviation,
        DRIFT.drag_deviation,
    ]
)


class Day(NamedTuple):
    """Of one session the data by kind, and what no sensor tells."""

    data: dict[str, list]
    moved: np.ndarray  # (n) of the joints' zeros against those of the arm [rad]
    acting: np.ndarray  # (5) SURROUNDINGS


def draw_arm(rng, guess=ARM, knowledge=DYNAMIC, kinematics=(0.005, 0.02)) -> Arm:
    """An arm that the guess is a poor description of: of lengths, angles, b and I least."""
    n = guess.n
    sigma = knowledge.deviations(guess)
    sigma[4 : 2 * n + 6] = kinematics[0]
    sigma[[*range(4 + n, 3 + 2 * n), 2 * n + 5]] = kinematics[1]
    v = values(guess) + sigma * rng.standard_normal(5 * n + 6)
    v[3 * n + 6 : 4 * n + 6] = [k.b for k in guess.links] + rng.uniform(-0.015, 0.015, n)
    v[4 * n + 6 :] = [k.inertia for k in guess.links] * rng.uniform(0.75, 1.25, n)
    return with_values(guess, v)


def turned(arm: Arm, moved) -> Arm:
    """The arm with other zeros of its joints."""
    n, v = arm.n, arm.vector()[kinematic_index(arm.n)]
    v[n : 2 * n - 1] += moved[1:]
    v[-1] += moved[0]
    return arm.with_kinematics(v)


def rests(arm, count, rng, start=0, s=KINEMATIC):
    q = rng.uniform(-1.3, 1.3, (count, arm.n))
    sigma = [s.position_deviation, s.position_deviation, s.heading_deviation]
    tip = tip_in_base(arm.vector(), q) + sigma * rng.standard_normal((count, 3))
    return observations(q, tip, start)


def maneuvers(arm, count, rng, acting, start=0, s=DYNAMIC, ends=None, rest=REST, along=False):
    """Of all joints to two more postures each, or to given ones; `along`: seen on the way, too."""
    found, marks = [], np.arange(BIN / 2, rest, BIN)
    fresh = min(FRAMES, s.fresh_rate * BIN)
    sigma = np.array([s.position_deviation] * 2 + [s.heading_deviation]) / np.sqrt(fresh)
    if ends is None:
        signs = rng.choice([-1.0, 1.0], (count, 3, arm.n))
        ends = signs * rng.uniform(0.6, 1.4, (count, 3, arm.n))
    for k, way in enumerate(ends):
        law, edges = moves(way)
        times = [np.arange(-PERIOD * rng.random(), edges[-1] + PERIOD, PERIOD) for _ in way[0]]
        read = [[part[:, i] for part in law(t)] for i, t in enumerate(times)]
        between = np.arange(BIN / 2, edges[-1], BIN) if along else []
        seen = np.array([*(marks - rest), *between, *(edges[-1] + marks)])
        amid = (seen > 0.0) & (seen < edges[-1])
        seconds = np.where(amid, LOOK, BIN)
        looks = np.sqrt(fresh / np.where(amid, np.maximum(1.0, fresh * LOOK / BIN), fresh))
        state = np.concatenate([
            rng.uniform(-0.5, 0.5, 2), rng.uniform(-3.0, 3.0, 1),
            rng.normal(0.0, s.momentum_deviation, 2), rng.normal(0.0, s.spin_deviation, 1),
            acting[:2],
        ])  # fmt: skip
        # The solver's path is the one through the samples: what they miss is another matter.
        path = joint_path.path(*joint_path.sampled(times, *zip(*read, strict=True)), seen)
        poses = base_motion.base_poses(arm.vector(), path, state)
        poses = poses + looks[:, None] * sigma * rng.standard_normal(poses.shape)
        at = start + k * 20 * SECOND
        found.append(
            Maneuver(
                at,
                at + 10 * SECOND,
                tuple(tuple(t + rest) for t in times),
                tuple(tuple(q) for q, _ in read),
                tuple(tuple(qd) for _, qd in read),
                tuple(seen + rest),
                tuple(map(tuple, poses.tolist())),
                (FRAMES,) * len(seen),
                tuple(seconds.tolist()),
            )
        )
    return found


def drifts(arm, count, rng, acting, start=0, s=DRIFT, length=40.0):
    found, times = [], np.arange(0.0, length, BIN)
    fresh = min(FRAMES, s.fresh_rate * BIN)
    sigma = np.array([s.position_deviation] * 2 + [s.heading_deviation]) / np.sqrt(fresh)
    for k in range(count):
        q = rng.uniform(-1.2, 1.2, arm.n)
        own = [*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0), *rng.normal(0.0, 0.003, 2),
               rng.normal(0.0, 0.02)]  # fmt: skip
        poses = drift(single_body(arm.vector(), q), acting, own, times)[:, :3]
        poses = poses + sigma * rng.standard_normal(poses.shape)
        found.append(drift_of(start + k * 100 * SECOND, length, q, times, poses))
    return found


def drift_of(start, length, q, times, poses) -> Drift:
    end, rows = start + round(length) * SECOND, map(tuple, poses.tolist())
    bins = (FRAMES,) * len(times), (BIN,) * len(times)
    return Drift(start, end, tuple(q), tuple(times), tuple(rows), *bins)


def day(arm, rng, counts=(13, 12, 3), zeros=0.0, number=0) -> Day:
    """So many rests, maneuvers and drifts, with surroundings of their own."""
    moved, acting = rng.normal(0.0, zeros, arm.n), SURROUNDINGS * rng.standard_normal(5)
    arm, start = turned(arm, moved), number * 86_400 * SECOND
    data = {
        "kinematic": rests(arm, counts[0], rng, start),
        "dynamic": maneuvers(arm, counts[1], rng, acting, start),
        "drift": drifts(arm, counts[2], rng, acting, start),
    }
    return Day({kind: some for kind, some in data.items() if some}, moved, acting)


#: As the paper's rests.
ROUGH = replace(
    KINEMATIC,
    position_deviation=KINEMATIC.max_position_deviation,
    heading_deviation=KINEMATIC.max_heading_deviation,
)


def errors(names, found, truth):
    """Of some of an arm's parameters, angles wrapped."""
    true = dict(zip(parameter_names(truth.n), values(truth), strict=True))
    error = np.array([x - true[name] for name, x in zip(names, found, strict=True)])
    angles = np.array([name.startswith("theta") for name in names])
    return np.where(angles, wrap(error), error)


def nees(names, found, covariance, truth):
    """Normalized squared error a parameter."""
    error = errors(names, found, truth)
    return error @ np.linalg.solve(covariance[: len(error), : len(error)], error) / len(error)


def kinematics(rests, guess=ARM, s=KINEMATIC):
    """The arm that a kinematic calibration leaves, with its covariance."""
    return fit_kinematics(kinematic_problem(rests, guess, s)).calibrated()


def dynamics(maneuvers, arm, s=DYNAMIC):
    """What a dynamic calibration finds that begins from an arm; no bound is in force."""
    return solve_dynamics(dynamic_problem(maneuvers, arm, s), bounded=False)


def forgotten(arm):
    """An arm of which nobody has told how well its kinematics are known."""
    return replace(arm, known=Known())
