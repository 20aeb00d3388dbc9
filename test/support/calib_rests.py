"""Observations at rest of the paper's arm, and a kinematic calibration of them to report."""

from dataclasses import replace
from itertools import count

import numpy as np

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.problem import HEADING_DEVIATION, POSITION_DEVIATION
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.units import SECOND

ARM = paper_arm()
SIGMA = np.array([POSITION_DEVIATION, POSITION_DEVIATION, HEADING_DEVIATION])
SETTINGS = KinematicSettings(
    max_outliers=1, position_deviation=POSITION_DEVIATION, heading_deviation=HEADING_DEVIATION
)


def observe(q=DEFAULT_POSTURES, seed=1, sigma=SIGMA, arm=ARM):
    """Observations of an arm at postures, with errors of `sigma` (3,): the paper's by default."""
    tips = tip_in_base(arm.vector(), q)
    tips = tips + sigma * np.random.default_rng(seed).normal(size=tips.shape)
    return observations(q, tips)


def observations(q, tips, start=0):
    """Observations at postures (s, n), one a second, from poses of the end effector (s, 3)."""
    return [
        Observation(t, t + 1, tuple(a), tuple(b), (0.0,) * 3, 10, 200)
        for t, a, b in zip(count(start, SECOND), q.tolist(), tips.tolist(), strict=False)
    ]


def seen_tips(tip, deviations, rng, count=1):
    """Poses (count, s, 3) with errors of relative positions, of the tip's and the base's heading.

    Each axis of a position errs by deviations[0], so both subjects together do.
    """
    of_position, of_tip, of_base = deviations
    shape = (count, len(tip))
    turn = of_base * rng.standard_normal(shape)
    off = of_position * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    seen = (tip[:, 0] + 1j * tip[:, 1] + off) * np.exp(-1j * turn)
    heading = tip[:, 2] - turn + of_tip * rng.standard_normal(shape)
    return np.stack([seen.real, seen.imag, heading], axis=-1)


def shifted(observation, x=0.0, y=0.0, heading=0.0):
    """The observation with another pose of the end effector."""
    return replace(observation, tip=tuple(np.add(observation.tip, (x, y, heading)).tolist()))


def with_outlier(count=13):
    """Of which the fifth is far off."""
    found = observe(DEFAULT_POSTURES[:count])
    return found[:4] + [shifted(one, 0.4) for one in found[4:5]] + found[5:]


def outcome(count=13, settings=SETTINGS):
    return calibrate(with_outlier(count), ARM, settings, source="a <bag>")
