"""Settings: a value's meaning, unit and bounds stand at its field."""

from dataclasses import dataclass, fields
from math import radians

import pytest

from fss_arm_model.settings import (
    FINITE,
    POSITIVE,
    SettingError,
    Settings,
    above,
    between,
    default_text,
    like,
    meaning,
    setting,
)


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


def test_meaning_unit_and_bounds_are_told_in_one_line():
    assert [meaning(f) for f in fields(Station)] == [
        "share that is full; above 0, at most 1",
        "sides [m]; each a positive number",
    ]
    slope = setting(0.0, "slope", unit="rad", check=FINITE)
    assert meaning(slope) == "slope [rad]"  # no number may be infinite
    assert between(300, 4_000_000).expected == "300 to 4000000"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (radians(0.1), "0.00174533"),
        (1e-5, "1e-05"),
        (0.0, "0.0"),
        (20e6, "20000000.0"),
        ((1.5, 2.0), "[1.5, 2.0]"),
        (True, "true"),
        ((), "[]"),
        ("", ""),
    ],
)
def test_a_default_is_shown_as_in_a_parameters_file_without_needless_digits(value, text):
    assert default_text(value) == text
