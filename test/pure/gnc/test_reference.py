from time import process_time

import numpy as np
import pytest

from fss_gnc.reference import Path, Reference, off


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_a_path_goes_through_its_knots_with_all_that_they_say(depth):
    rng = np.random.default_rng(depth)
    times, knots = np.array([0.0, 0.7, 3.0, 3.5]), rng.normal(size=(4, depth, 3))
    path = Path(times, knots)
    for t, knot in zip(times[:-1], knots[:-1], strict=True):
        found = path.at(t)
        got = np.array([found.pose, found.twist, found.acceleration])[:depth]
        np.testing.assert_allclose(got, knot, atol=1e-12)


def test_twist_and_acceleration_are_the_derivatives_of_the_pose():
    begin = Reference(np.array([0.1, -0.2, 3.0]), np.array([0.05, 0.0, -0.1]), np.zeros(3))
    path, h = Path.between(begin, [1.0, 0.5, 2.0], 2.0, 30.0), 1e-4
    for t in (2.5, 17.0, 31.0):
        before, here, after = (path.at(t + d) for d in (-h, 0.0, h))
        np.testing.assert_allclose((after.pose - before.pose) / (2 * h), here.twist, atol=1e-8)
        slope = (after.twist - before.twist) / (2 * h)
        np.testing.assert_allclose(slope, here.acceleration, atol=1e-8)


def test_a_path_rests_before_and_after():
    path = Path(np.array([1.0, 2.0]), np.ones((2, 2, 3)))
    for t in (0.0, 2.0, 5.0):
        np.testing.assert_array_equal(path.at(t).pose, np.ones(3))
        np.testing.assert_array_equal(path.at(t).twist, np.zeros(3))


def test_ten_thousand_knots_are_looked_at_in_no_time():
    """A guidance that stood still for a second would let go of the base that it holds."""
    path = Path(np.arange(10_000.0), np.zeros((10_000, 2, 3)))
    begun = process_time()
    path.sampled(0.0, 80_000)
    assert process_time() - begun < 0.5  # 0.03 s; 1.5 s one time after the other


@pytest.mark.parametrize(
    ("times", "knots", "words"),
    [
        ([], np.zeros((0, 1, 3)), "no points"),
        ([0.0, 0.0], np.zeros((2, 1, 3)), "time of point 1 is 0 s"),
        ([0.0, 1.0], np.full((2, 1, 3), np.nan), "not finite"),
        ([0.0, np.inf], np.zeros((2, 1, 3)), "not finite"),
    ],
)
def test_what_is_no_path_is_refused(times, knots, words):
    with pytest.raises(ValueError, match=words):
        Path(np.array(times), knots)


def test_a_turn_is_the_shorter_one():
    np.testing.assert_allclose(off([0, 0, 3.0], [0, 0, -3.0]), [0, 0, 6.0 - 2 * np.pi])
