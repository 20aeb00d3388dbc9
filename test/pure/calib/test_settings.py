"""Settings that cannot be are refused with the value and what is expected."""

import re

import pytest

from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.settings import Conditions
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.settings import ManeuverSettings, RestSettings


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (RestSettings, {"motion_threshold": 0.0}, "motion_threshold is 0 rad (0 deg), expected a"),
        (RestSettings, {"min_duration": 3.0}, "max_duration is 2.0 s, expected 3.0 or more"),
        (RestSettings, {"vicon_gap": float("nan")}, "vicon_gap is nan s, expected a positive numb"),
        (ManeuverSettings, {"time_offset": -60.0}, "time_offset is -60.0 s, expected within"),
        (KinematicSettings, {"max_condition": 1.0}, "max_condition is 1.0, expected more than 1"),
        (KinematicSettings, {"min_probability": 1.0}, "is 1.0, expected 0 or more, and below 1"),
        (KinematicSettings, {"held_out": 1}, "held_out is 1, expected 0, or 2 or more"),
        (KinematicSettings, {"loss": "none"}, "loss is 'none', expected one of square, huber, cau"),
        (KinematicSettings, {"base_topic": "x", "tip_topic": "x"},
         "base_topic and tip_topic are both 'x', expected two topics"),
        (DynamicSettings, {"tip_topic": "vicon/fss/fss"},
         "base_topic and tip_topic are both 'vicon/fss/fss', expected two topics"),
        (Conditions, {"duration": 0.0}, "duration is 0.0 s, expected a positive number"),
        (Conditions, {"kinds": ("spin",)}, "expected one of single, sweep, loop"),
        (DynamicSettings, {"residuals": "tip"}, "residuals is 'tip', expected one of pose, headi"),
        (DynamicSettings, {"estimate": "b_i q"}, "estimate has 'q'"),
        (DynamicSettings, {"estimate": ""}, "names no parameter"),
        (DynamicSettings, {"estimate": "I_1 I_i"}, "names I_1 twice"),
        (DynamicSettings, {"b_deviation": float("inf")}, "b_deviation is inf m, expected 0 or mor"),
        (DynamicSettings, {"base_com_deviation": 0.0},
         "estimate has 'com_0', known exactly (its deviation is 0): remove it"),
    ],
)  # fmt: skip
def test_impossible_settings_are_refused(kind, change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        kind(**change)


def test_what_is_not_estimated_may_be_known_exactly():
    DynamicSettings(base_com_deviation=0.0, length_deviation=0.0, estimate="b_i I_i")
