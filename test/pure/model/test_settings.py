"""Settings that are like others, and angles in degrees."""

from dataclasses import dataclass
from math import inf, nan, pi, radians

import pytest

from fss_arm_model.settings import (
    POSITIVE,
    SettingError,
    Settings,
    above,
    like,
    setting,
)
from fss_arm_model.units import angle_beyond, in_degrees


@dataclass(frozen=True)
class Tank(Settings):
    share: float = setting(0.5, "share that is full", check=above(0.0, 1.0))
    sides: tuple[float, ...] = setting((1.0, 2.0), "sides", unit="m", check=POSITIVE, size=2)


@dataclass(frozen=True)
class Station(Settings):
    tank_share: float = like(Tank, "share", 1.0)
    tank_sides: tuple[float, ...] = like(Tank, "sides")


def test_a_field_is_like_another_under_its_own_name_and_default():
    assert Station() == Station(1.0, (1.0, 2.0))
    with pytest.raises(SettingError, match=r"^tank_share is 0.0, expected above 0, at most 1$"):
        Station(tank_share=0.0)
    with pytest.raises(SettingError, match=r"^tank_sides is -1.0 m, expected a positive number$"):
        Station(tank_sides=(1.0, -1.0))
    with pytest.raises(SettingError, match=r"^tank_sides has 1 numbers, expected 2$"):
        Station(tank_sides=(1.0,))


def test_angles_are_shown_in_degrees_with_four_digits():
    assert in_degrees([radians(10.0), 1.0, -pi / 2, 0.0]) == "10, 57.3, -90, 0 deg"


@pytest.mark.parametrize(
    ("angle", "text"),
    [
        (1.7453292519943295, "100 deg"),
        (1.5708, "90 deg (0.00021 deg beyond)"),
        (-1.5708, "-90 deg (0.00021 deg beyond)"),
        (nan, "nan deg"),
        (inf, "inf deg"),
        (1e18, "5.73e+19 deg"),
    ],
)
def test_an_angle_beyond_its_range_is_shown_with_it(angle, text):
    assert angle_beyond(angle, -pi / 2, pi / 2) == f"{text}, expected -90 to 90 deg"
