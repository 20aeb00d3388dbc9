"""A kinematic calibration to report, with one outlier."""

import numpy as np
from calib_rig import ARM

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.problem import HEADING_DEVIATION, POSITION_DEVIATION
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.kinematics import tip_in_base

SETTINGS = KinematicSettings(
    max_outliers=1, position_deviation=POSITION_DEVIATION, heading_deviation=HEADING_DEVIATION
)


def observations(count=13):
    """With the errors assumed, the fifth far off."""
    tips = tip_in_base(ARM.vector(), DEFAULT_POSTURES[:count])
    sigma = [SETTINGS.position_deviation] * 2 + [SETTINGS.heading_deviation]
    tips = tips + np.random.default_rng(1).normal(size=tips.shape) * sigma
    if count > 4:
        tips[4, 0] += 0.4
    pairs = zip(DEFAULT_POSTURES.tolist(), tips.tolist(), strict=False)
    return [Observation(k, k + 1, tuple(q), tuple(tip)) for k, (q, tip) in enumerate(pairs)]


def outcome(count=13, settings=SETTINGS):
    return calibrate(observations(count), ARM, settings, source="a <bag>")
