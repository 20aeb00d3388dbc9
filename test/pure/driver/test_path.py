"""Paths in time, as a link keeps and follows them."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from fss_arm_driver.protocol import hermite


@pytest.mark.parametrize(
    ("duration", "p0", "v0", "p1", "v1"),
    [(2.0, 0.0, 0.0, 1.0, 0.0), (0.001, 5e8, -3e5, 5e8 + 40, 8e4), (60.0, -1e9, 1e6, 1e9, 0.0)],
)
def test_between_two_knots_a_path_is_their_cubic(duration, p0, v0, p1, v1):
    spline = CubicHermiteSpline([0.0, duration], [p0, p1], [v0, v1])
    for t in np.linspace(0.0, duration, 11):
        expected = float(spline(t)), float(spline(t, 1))
        assert hermite(t, duration, p0, v0, p1, v1) == pytest.approx(expected, rel=1e-9, abs=1e-6)
