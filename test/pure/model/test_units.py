from math import inf, nan, pi, radians

import pytest

from fss_arm_model.units import angle_beyond, in_degrees


def test_angles_are_shown_in_degrees_with_four_digits():
    assert in_degrees([radians(10.0), 1.0, -pi / 2, 0.0]) == "10, 57.3, -90, 0 deg"


@pytest.mark.parametrize(
    ("angle", "text"),
    [
        (1.7453292519943295, "100 deg, expected -90 to 90 deg"),
        (1.5708, "90 deg (0.00021 deg beyond), expected -90 to 90 deg"),
        (-1.5708, "-90 deg (0.00021 deg beyond), expected -90 to 90 deg"),
        (nan, "nan deg, expected -90 to 90 deg"),
        (inf, "inf deg, expected -90 to 90 deg"),
        (1e18, "5.73e+19 deg, expected -90 to 90 deg"),
    ],
)
def test_an_angle_beyond_its_range_is_shown_with_it(angle, text):
    assert angle_beyond(angle, -pi / 2, pi / 2) == text
