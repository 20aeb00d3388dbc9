"""Settings that cannot be are refused with the value and what is expected."""

import re

import pytest

from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.settings import ManeuverSettings, RestSettings

BELOW_1 = "expected 0 or more, and below 1"


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (
            RestSettings,
            {"motion_threshold": 0.0},
            "motion_threshold is 0 rad (0 deg), expected a posit",
        ),
        (RestSettings, {"settle_time": -1.0}, "settle_time is -1.0 s, expected 0 or more"),
        (RestSettings, {"min_duration": 3.0}, "max_duration is 2.0 s, expected 3.0 or more"),
        (RestSettings, {"vicon_gap": float("nan")}, "vicon_gap is nan s, expected a positive numb"),
        (ManeuverSettings, {"time_offset": -60.0}, "time_offset is -60.0 s, expected within"),
        (KinematicSettings, {"min_observations": 0}, "min_observations is 0, expected 1 or more"),
        (KinematicSettings, {"max_condition": 1.0}, "max_condition is 1.0, expected more than 1"),
        (KinematicSettings, {"min_probability": 1.0}, f"min_probability is 1.0, {BELOW_1}"),
        (KinematicSettings, {"outlier": 0.0}, "outlier is 0.0 deviations, expected a pos"),
        (KinematicSettings, {"max_outliers": -1}, "max_outliers is -1, expected 0 or more"),
        (KinematicSettings, {"min_redundancy": 1.0}, f"min_redundancy is 1.0, {BELOW_1}"),
        (KinematicSettings, {"held_out": 1}, "held_out is 1, expected 0, or 2 or more"),
        (KinematicSettings, {"loss": "none"}, "loss is 'none', expected one of square, huber, cau"),
        (DynamicSettings, {"bin": 0.0}, "bin is 0.0 s, expected a positive number"),
        (DynamicSettings, {"residuals": "tip"}, "residuals is 'tip', expected one of pose, headi"),
        (DynamicSettings, {"estimate": "b_i q"}, "estimate has 'q'"),
        (DynamicSettings, {"fresh_rate": 0.0}, "fresh_rate is 0.0 1/s, expected a positive numbe"),
        (
            DynamicSettings,
            {"tilt_deviation": -1.0},
            "tilt_deviation is -1 rad (-57.3 deg), expected 0 or mo",
        ),
        (DynamicSettings, {"mass_deviation": -1.0}, "mass_deviation is -1.0 kg, expected 0 or mor"),
        (DynamicSettings, {"b_deviation": float("inf")}, "b_deviation is inf m, expected 0 or mor"),
        (DynamicSettings, {"min_maneuvers": 0}, "min_maneuvers is 0, expected 1 or more"),
        (
            DynamicSettings,
            {"base_com_deviation": 0.0},
            "estimate has 'com_0', known exactly (its deviation is 0): remove it",
        ),
        (DynamicSettings, {"inertia_deviation": 0.0, "estimate": "I"}, "estimate has 'I', known"),
    ],
)
def test_impossible_settings_are_refused(kind, change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        kind(**change)


def test_what_is_not_estimated_may_be_known_exactly():
    DynamicSettings(base_com_deviation=0.0, length_deviation=0.0, estimate="b_i I_i")
