"""Straight moves: the drives' speed profile, and the time that speed and torque need."""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.straight_moves import RAMP_SHARE, speed_profile, torque_limited_duration

ARM = paper_arm()


def test_a_profile_is_a_trapezoid_of_the_rate():
    x = np.linspace(0.0, 1.0, 100_001)
    way, rate, acceleration = speed_profile(x)
    assert (way[0], way[-1]) == (0.0, 1.0)
    assert np.trapezoid(rate, x) == pytest.approx(1.0, abs=1e-9)
    assert np.gradient(way, x)[1:-1] == pytest.approx(rate[1:-1], abs=1e-4)
    assert rate.max() == 1.0 / (1.0 - RAMP_SHARE)
    assert np.trapezoid(acceleration, x) == pytest.approx(0.0, abs=1e-3)


def test_time_grows_with_what_torque_asks():
    def duration(share):
        drive = replace(ARM.links[0].drive, max_current=share * ARM.links[0].drive.max_current)
        arm = replace(ARM, links=tuple(replace(k, drive=drive) for k in ARM.links))
        return torque_limited_duration(arm, np.zeros(4), np.array([1.2, 0.0, 0.0, 0.0]))

    assert duration(0.05) == pytest.approx(duration(0.1) * np.sqrt(2.0), rel=1e-6)
    assert duration(0.1) > duration(1.0)
