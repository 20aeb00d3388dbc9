"""Boundary of arcs against inverse kinematics by descent; consistency of the boundary."""

import math
from dataclasses import replace

import numpy as np
import pytest
from model_arms import random_arm
from workspace_oracle import reachable, sampled, tips

from fss_arm_model.description import paper_arm
from fss_arm_workspace.regions.arcs import Arcs, enclose
from fss_arm_workspace.regions.fixed import fixed_workspace, joint_limits

MARGIN = 1e-6  # from the boundary, where membership must be right [m]


def around(region, count, rng):
    """Return random points of the box around a region, and the box's area."""
    edge = np.concatenate([points for points, _ in region.outlines(0.02)])
    low, high = (f(edge.real) + 1j * f(edge.imag) for f in (np.min, np.max))
    size = high - low
    points = low + rng.random(count) * size.real + 1j * rng.random(count) * size.imag
    return points, size.real * size.imag


def polygon_area(region, spacing):
    """Return the area of polygons, with holes, by the shoelace formula."""
    lines = [points for points, _ in region.outlines(spacing)]
    return sum(0.5 * (np.roll(z, -1) * z.conj()).imag.sum() for z in lines)


def is_sound(region, arm, limits, rng, count=500):
    """Check `contains` for arrays, single points and reached tips."""
    holds_what_is_reached(region, arm, limits, rng)
    disagreements(region, arm, limits, count, rng)


def holds_what_is_reached(region, arm, limits, rng):
    """Loops close, postures belong to their points, and samples lie inside."""
    p = arm.vector()
    for loop in region.loops:
        assert np.abs(np.roll(loop.at(0.0), -1) - loop.at(1.0)).max() < 1e-12
    for points, q in region.outlines(0.02):
        assert np.abs(tips(p, q) - points).max() < 1e-12
        assert (q >= limits[:, 0] - 1e-12).all()
        assert (q <= limits[:, 1] + 1e-12).all()
    z = sampled(p, limits, 10_000, rng)[1]
    assert region.distance(z[~region.contains(z)]).max(initial=0.0) < 1e-12


def disagreements(region, arm, limits, count, rng):
    points, _ = around(region, count, rng)
    points = points[region.distance(points) > MARGIN]
    inside = region.contains(points)
    assert np.array_equal(reachable(arm.vector(), limits, points, rng, hopes=inside), inside)


def test_the_papers_workspace_by_hand():
    """Fully stretched, the tip draws half a circle of the arm's length about joint 1."""
    arm, region = paper_arm(), fixed_workspace(paper_arm())
    assert len(region.loops) == 2
    outer, hole = region.areas
    assert outer > 0.0 > hole
    assert region.area == pytest.approx(6.1576, abs=1e-4)
    longest = region.arcs[[np.argmax(region.arcs.radius)]]
    assert longest.radius == pytest.approx(sum(link.a for link in arm.links))
    assert longest.center == pytest.approx(complex(*arm.base.mount[:2]))
    assert longest.sweep == pytest.approx(math.pi)


def test_polygons_converge_to_the_area():
    """The error of a polygon falls with the square of its spacing."""
    region = fixed_workspace(paper_arm())
    errors = [abs(polygon_area(region, spacing) - region.area) for spacing in (1e-2, 1e-3, 1e-4)]
    assert errors[2] < 1e-6 / 10
    assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.1)


@pytest.mark.slow
def test_contains_agrees_with_inverse_kinematics():
    arm = paper_arm()
    limits = joint_limits(arm)
    disagreements(fixed_workspace(arm), arm, limits, 100_000, np.random.default_rng(1))


@pytest.mark.parametrize("count", [10_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_the_area_agrees_with_a_monte_carlo(count):
    arm, rng = paper_arm(), np.random.default_rng(2)
    region, share = fixed_workspace(arm), 0
    points, box = around(region, count, rng)
    for part in np.array_split(points, max(1, count // 50_000)):
        share += reachable(arm.vector(), joint_limits(arm), part, rng, starts=6).sum() / count
    deviation = box * math.sqrt(share * (1.0 - share) / count)
    assert abs(box * share - region.area) < 3.0 * deviation


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (3, 1), (4, 0), (6, 1)])
def test_any_arm_and_any_limits(n, seed):
    rng = np.random.default_rng(10 * n + seed)
    arm = random_arm(n, rng)
    limits = np.sort(rng.uniform(-math.pi, math.pi, (n, 2)), axis=1)
    if seed:
        limits[rng.integers(n)] = -4.0, 4.0  # a joint without limits
    is_sound(fixed_workspace(arm, limits), arm, limits, rng)


@pytest.mark.parametrize(("n", "degrees"), [(2, 60.0), (4, 90.0), (4, 180.0)])
def test_equal_links_whose_arcs_touch_and_coincide(n, degrees):
    link = replace(paper_arm().links[0], a=0.4)
    arm = replace(paper_arm(), links=(link,) * n)
    limits = np.radians([[-degrees, degrees]] * n)
    region = fixed_workspace(arm, limits)
    is_sound(region, arm, limits, np.random.default_rng(n))
    if degrees == 180.0:
        assert region.area == pytest.approx(math.pi * (0.4 * n) ** 2)


def test_arcs_of_a_long_arm_touch_up_to_a_larger_rounding_error():
    links = paper_arm().links
    arm = replace(paper_arm(), links=links[:3] * 3 + links[:2] + links[3:])
    region = fixed_workspace(arm)
    assert region.area == pytest.approx(62.7746, abs=1e-4)
    holds_what_is_reached(region, arm, joint_limits(arm), np.random.default_rng(12))


def test_arcs_that_barely_touch():
    arm = replace(paper_arm(), links=(replace(paper_arm().links[0], a=0.4),) * 5)
    limits = [(-1.236, 0.3), (-3.163, 0.05), (-2.5, 4.0), (-1.571, -0.124), (-0.05, 0.05)]
    region = fixed_workspace(arm, limits)
    holds_what_is_reached(region, arm, np.array(limits), np.random.default_rng(0))


def test_an_open_boundary_is_rejected():
    half = Arcs(*(np.array([x]) for x in (0j, 1.0, 0.0, math.pi, 0)), np.zeros((1, 1)))
    with pytest.raises(ValueError, match="boundary has a gap of 2 m, expected none"):
        enclose(half, lambda points: np.abs(points) < 1.0)


def test_two_links_without_limits_leave_a_hole():
    first = paper_arm().links[0]
    arm = replace(paper_arm(), links=(replace(first, a=0.5), replace(first, a=0.3)))
    region = fixed_workspace(arm, np.array([[-4.0, 4.0]] * 2))
    assert region.areas == pytest.approx([math.pi * 0.8**2, -math.pi * 0.2**2])
    assert region.extent(complex(*arm.base.mount[:2])) == pytest.approx((0.2, 0.8))


def test_limits_hold_for_the_encoder_by_default():
    arm = paper_arm()
    by_encoder, by_angle = joint_limits(arm), joint_limits(arm, of_true_angle=True)
    assert by_encoder == pytest.approx(np.array([[-math.pi / 2, math.pi / 2]] * 4))
    assert by_encoder - by_angle == pytest.approx(np.array([[k.theta_0] * 2 for k in arm.links]))
    areas = [fixed_workspace(arm, limits).area for limits in (by_encoder, by_angle)]
    assert abs(areas[0] - areas[1]) > 1e-4


@pytest.mark.parametrize("limits", [[[0.0, 1.0]], [[1.0, 0.0]] * 4, [[0.0, 0.0]] * 4])
def test_invalid_limits_are_rejected(limits):
    with pytest.raises(ValueError, match=r"limits are .*, expected 4 pairs"):
        fixed_workspace(paper_arm(), np.array(limits))


def test_infinite_limits_are_rejected():
    with pytest.raises(ValueError, match=r"limits are .*inf.*, expected finite angles"):
        fixed_workspace(paper_arm(), np.array([[-math.inf, math.inf]] + [[-1.0, 1.0]] * 3))
