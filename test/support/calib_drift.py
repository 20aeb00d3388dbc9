"""Drifts of the simulated base with its arm at rest, and what truly acted on it."""

from typing import NamedTuple

import numpy as np
from calib_joint import BIN, drift_of

from fss_arm_calib.drift.problem import DriftProblem
from fss_arm_model.description import paper_arm
from fss_arm_model.drifting import single_body
from fss_arm_model.units import GRAVITY, SECOND
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.vehicle import Demand, World

ARM = paper_arm()
TILT = (8e-5, -5e-5)  # [rad]
TETHER, TWIST = 0.02, 0.003  # [N s/m], [N m s]
SHARED = np.array([GRAVITY * TILT[0], GRAVITY * TILT[1], 0.0, TWIST, TETHER])
SIGMA = np.array([0.001, 0.001, 0.009])  # of a VICON frame [m, m, rad]
FRESH = 5  # frames in an averaged pose


class Truth(NamedTuple):
    """What no sensor tells."""

    hose_torque: float  # mean [N m]
    momenta: np.ndarray  # (s, 3) at the first pose


def drifts(seed, count=4, length=40.0, tilt=TILT, tether=TETHER, twist=TWIST):
    """Drifts [Drift], and the Truth, from starts at random."""
    rng = np.random.default_rng(seed)
    free = (40.0, 40.0)  # a table without a border to touch
    world = World(surroundings=Surroundings(tilt, 0.0, tether, twist, free))
    found, momenta, gains = [], [], []
    times = np.arange(0.0, length, BIN)
    for k in range(count):
        q = rng.uniform(-1.2, 1.2, ARM.n)
        begin = [*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0)]
        twist_then = [*rng.normal(0.0, 0.003, 2), rng.normal(0.0, 0.02)]
        plant = Plant(ARM, [*begin, *q], [*twist_then, *np.zeros(ARM.n)], world)
        for j in range(ARM.n):
            plant.command(j, Demand(21, q[j], 0.0))
        momenta.append(plant.momentum())
        poses = [plant.base]
        for _ in times[1:]:
            plant.advance(BIN)
            poses.append(plant.base)
        gains.append(plant.momentum()[2] - momenta[-1][2])
        seen = np.array(poses) + rng.standard_normal((len(times), 3)) * SIGMA / np.sqrt(FRESH)
        found.append(drift_of(k * 1000 * SECOND, length, q, times, seen))
    return found, Truth(sum(gains) / (count * times[-1]), np.array(momenta))


def problem(found, seed=0, com=0.01, **known):
    """The problem of drifts, each with its centre of mass known to `com` alone, masses exactly."""
    rng = np.random.default_rng(1000 + seed)
    sigma = [np.tile(SIGMA / np.sqrt(FRESH), (len(d.times), 1)) for d in found]
    bodies = single_body(ARM.vector(), np.array([d.q for d in found]))
    bodies[:, 2:] += rng.normal(0.0, com, (len(found), 2))
    hose = {"torque": 0.05, "twist_damping": 0.01, "drag": 0.05}
    return DriftProblem(found, bodies, sigma, **{**hose, "com": com, "mass": 0.0, **known})
