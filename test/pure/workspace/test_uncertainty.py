"""First-order deviations against a Monte Carlo over the parameters."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fss_arm_model.description import paper_arm
from fss_arm_model.layout import kinematic_index
from fss_arm_ros.calibrated import Calibrated, vector_covariance
from fss_arm_workspace.analysis import AnalysisSettings, analyze
from fss_arm_workspace.manipulability.climb import climb
from fss_arm_workspace.manipulability.measure import FIXED, FLOATING
from fss_arm_workspace.manipulability.search import Search
from fss_arm_workspace.regions.fixed import fixed_workspace, joint_limits
from fss_arm_workspace.regions.virtual import VirtualManipulator
from fss_arm_workspace.uncertainty import (
    boundary_deviation,
    measure_deviation,
    radius_deviation,
)

NAMES = ("a", "a_4", "theta_0_2", "theta_0_3", "theta_0_4", "x_BJ1", "y_BJ1", "theta_BJ1")
DEVIATIONS = np.array([4e-3, 6e-3, 0.02, 0.03, 0.03, 5e-3, 5e-3, 0.015])


def covariance(rng):
    mix = np.eye(len(NAMES)) + 0.3 * rng.standard_normal((len(NAMES), len(NAMES)))
    root = 0.3 * DEVIATIONS[:, None] * mix
    return root @ root.T


def drawn(arm, C, rng, count):
    """Return arms with random kinematics, drawn from the covariance."""
    for x in rng.multivariate_normal(np.zeros(len(NAMES)), C, count):
        values = arm.vector()[kinematic_index(4)]
        yield arm.with_kinematics(values + x[[0, 0, 0, 1, 2, 3, 4, 5, 6, 7]])


@pytest.mark.slow
def test_deviations_agree_with_a_monte_carlo():
    """200 draws give a standard deviation to 5 %; the bounds are 4 times as wide."""
    arm, rng = paper_arm(), np.random.default_rng(0)
    C = covariance(rng)
    wide = vector_covariance(arm, NAMES, C)
    limits, region = joint_limits(arm), fixed_workspace(arm)
    lines = boundary_deviation(arm, region, wide, spacing=0.05)
    points = np.array([[0.9, 0.3], [0.2, 0.9], [-0.5, -0.6]])
    best = Search(arm, FIXED, spacing=0.1).at(points)
    expected = measure_deviation(arm, best, points, limits, FIXED, wide)
    outer = lines[0][0][::20]
    found, w = [], []
    for other in drawn(arm, C, rng, 200):
        moved = fixed_workspace(other)
        found.append(moved.distance(outer) * np.where(moved.contains(outer), 1.0, -1.0))
        w.append(climb(other.vector(), best.q, points, limits, FIXED)[1])
    assert_allclose(np.std(found, axis=0), lines[0][1][::20], rtol=0.25)
    assert_allclose(np.std(w, axis=0), expected, rtol=0.25)


def test_limits_of_the_true_angle_fix_the_boundary():
    """The deviation then does not depend on theta_0, and on the other parameters as before."""
    arm = paper_arm()
    region = fixed_workspace(arm, joint_limits(arm, of_true_angle=True))
    offsets = vector_covariance(arm, ["theta_0_2", "theta_0_4"], np.diag([0.02**2] * 2))
    length = vector_covariance(arm, ["a_2"], [[1e-6]])

    def covariance_of(C, of_true_angle):
        lines = boundary_deviation(arm, region, C, of_true_angle=of_true_angle)
        return np.concatenate([deviation for _, deviation in lines])

    assert covariance_of(offsets, False).max() > 5e-3
    assert covariance_of(offsets, True).max() < 1e-9
    assert_allclose(covariance_of(offsets + length, True), covariance_of(length, False), atol=1e-9)


def test_deviation_of_the_radius_by_hand():
    """R grows with a length by the share of the mass before it."""
    arm = paper_arm()
    wide = vector_covariance(arm, ["a_2"], [[1e-6]])
    share = (10.0 + 2.88) / (10.0 + 4 * 2.88)
    assert radius_deviation(arm, wide) == pytest.approx(1e-3 * share, rel=1e-6)
    heavier = vector_covariance(arm, ["m_0"], [[0.1**2]])
    bases = [replace(arm.base, mass=mass) for mass in (9.9, 10.1)]
    low, high = (VirtualManipulator(replace(arm, base=base)).radius for base in bases)
    assert radius_deviation(arm, heavier) == pytest.approx((high - low) / 2.0, rel=1e-3)


def test_an_analysis_gives_the_deviation_of_the_largest_w():
    """Two links at right angles: w = a_1 a_2, where only a_2 is uncertain."""
    arm = replace(paper_arm(), links=paper_arm().links[:2])
    C = vector_covariance(arm, ["a_2", "theta_0_2"], np.diag([1e-6, 0.02**2]))
    settings = AnalysisSettings(cell=0.02, of_true_angle=True)
    found = analyze(Calibrated(arm, C), settings)
    w, spread = found.largest_w["fixed"]
    assert w == pytest.approx(0.3825**2, rel=0.01) == np.nanmax(found.maps["fixed"].w)
    assert spread == pytest.approx(1e-3 * 0.3825, rel=0.05)
    assert found.largest_w["floating"][1] > 0.0
    assert max(deviation.max() for _, deviation in found.boundary) < 1.001e-3


def test_names_that_links_share():
    arm = paper_arm()
    assert_allclose(
        vector_covariance(arm, ["a"], [[1.0]]), vector_covariance(arm, ["a_1 .. a_3"], [[1.0]])
    )
    one = vector_covariance(arm, ["I"], [[1.0]])
    assert np.flatnonzero(np.diag(one)).tolist() == [11, 17, 23, 29]
    with pytest.raises(ValueError, match="arm 'paper' has no parameter 'c_1'"):
        vector_covariance(arm, ["c_1"], [[1.0]])


def test_floating_deviations_need_masses_too():
    arm = paper_arm()
    points = np.array([[0.9, 0.3]])
    best = Search(arm, FLOATING, spacing=0.2).at(points)
    limits = joint_limits(arm)
    wide = vector_covariance(arm, ["I_0", "m_0"], np.diag([0.025**2, 0.05**2]))
    assert measure_deviation(arm, best, points, limits, FLOATING, wide)[0] > 1e-4
    assert measure_deviation(arm, best, points, limits, FIXED, wide)[0] < 1e-9
