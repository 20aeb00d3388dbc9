from time import process_time

import numpy as np
import pytest

from fss_gnc.reference import Path, Reference, pose_error


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_path_passes_through_its_knots(depth):
    rng = np.random.default_rng(depth)
    times, knots = np.array([0.0, 0.7, 3.0, 3.5]), rng.normal(size=(4, depth, 3))
    path = Path(times, knots)
    for t, knot in zip(times[:-1], knots[:-1], strict=True):
        found = path.at(t)
        got = np.array([found.pose, found.twist, found.acceleration])[:depth]
        np.testing.assert_allclose(got, knot, atol=1e-12)


def test_twist_and_acceleration_are_the_derivatives_of_the_pose():
    initial = Reference(np.array([0.1, -0.2, 3.0]), np.array([0.05, 0.0, -0.1]), np.zeros(3))
    path, h = Path.between(initial, [1.0, 0.5, 2.0], 2.0, 30.0), 1e-4
    for t in (2.5, 17.0, 31.0):
        before, here, after = (path.at(t + d) for d in (-h, 0.0, h))
        np.testing.assert_allclose((after.pose - before.pose) / (2 * h), here.twist, atol=1e-8)
        slope = (after.twist - before.twist) / (2 * h)
        np.testing.assert_allclose(slope, here.acceleration, atol=1e-8)


def test_path_is_at_rest_before_and_after():
    path = Path(np.array([1.0, 2.0]), np.ones((2, 2, 3)))
    for t in (0.0, 2.0, 5.0):
        np.testing.assert_array_equal(path.at(t).pose, np.ones(3))
        np.testing.assert_array_equal(path.at(t).twist, np.zeros(3))


def test_ten_thousand_knots_are_sampled_quickly():
    """A guidance that stalls for a second loses the base that it holds."""
    path = Path(np.arange(10_000.0), np.zeros((10_000, 2, 3)))
    start = process_time()
    path.sample(0.0, 80_000)
    assert process_time() - start < 0.5  # 0.03 s; 1.5 s if sampled one by one


@pytest.mark.parametrize(
    ("times", "knots", "message"),
    [
        ([], np.zeros((0, 1, 3)), "no points"),
        ([0.0, 0.0], np.zeros((2, 1, 3)), "time of point 1 is 0 s"),
        ([0.0, 1.0], np.full((2, 1, 3), np.nan), "not finite"),
        ([0.0, np.inf], np.zeros((2, 1, 3)), "not finite"),
    ],
)
def test_invalid_path_is_rejected(times, knots, message):
    with pytest.raises(ValueError, match=message):
        Path(np.array(times), knots)


def test_pose_error_takes_the_shorter_turn():
    np.testing.assert_allclose(pose_error([0, 0, 3.0], [0, 0, -3.0]), [0, 0, 6.0 - 2 * np.pi])
