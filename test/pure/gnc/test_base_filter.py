"""The base's filter, against flights that are known."""

import numpy as np

from fss_gnc.navigation import BaseFilter, SensorErrors


def fly(filter_, errors, seed, end=20.0):
    """A base that turns and drifts; poses at 100 Hz, the gyro at 100 Hz with a bias."""
    rng = np.random.default_rng(seed)
    found = []
    truth = lambda t: np.array([0.05 * t, -0.02 * t, 3.0 + 0.2 * t + 0.3 * np.sin(t)])  # noqa: E731
    for k in range(int(end * 100)):
        t = k * 10_000_000
        x, y, heading = truth(t * 1e-9) + rng.normal(
            0, [errors.position_error, errors.position_error, errors.heading_error]
        )
        omega = 0.2 + 0.3 * np.cos(t * 1e-9 + 0.005) + 0.003 + rng.normal(0, errors.rate_error)
        found += filter_.rate(t + 5_000_000, omega)
        wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
        found += filter_.pose(t, x, y, wrapped)
    return found, truth


def test_the_filter_is_as_good_as_it_says():
    errors = SensorErrors(bias_walk=1e-6)
    found, truth = fly(BaseFilter(errors), errors, 1)
    late = [e for e in found if e.t > 10_000_000_000]
    off = np.array([e.pose - truth(e.t * 1e-9) for e in late])
    assert (np.abs(off) < 5.0 * np.sqrt(late[-1].pose_variance)).all()
    assert np.abs(off[:, 2]).max() < 0.5 * errors.heading_error  # the gyro helps
    assert late[-1].pose[2] > 3.0 + 3.0  # unwrapped
    rates = np.array([e.twist[2] - 0.2 - 0.3 * np.cos(e.t * 1e-9) for e in late])
    assert np.abs(rates).max() < 5.0 * late[-1].twist_variance[2] ** 0.5  # bias 0.003 found


def test_a_swapped_subject_is_rejected_and_a_moved_one_believed_in_the_end():
    filter_ = BaseFilter()
    for k in range(100):
        filter_.pose(k * 10_000_000, 0.0, 0.0, 0.0)
    for k in range(100, 105):
        filter_.pose(k * 10_000_000, 1.0, 1.0, 1.0)
    found = [e for k in range(105, 200) for e in filter_.pose(k * 10_000_000, 0.0, 0.0, 0.0)]
    assert filter_.rejected == {"pose": 5}
    assert max(np.abs(e.pose).max() for e in found) < 1e-6
    found = [e for k in range(200, 260) for e in filter_.pose(k * 10_000_000, 1.0, 1.0, 1.0)]
    np.testing.assert_allclose(found[-1].pose, 1.0, atol=1e-6)


def test_a_rate_that_is_no_number_ruins_nothing():
    filter_, clean = BaseFilter(), BaseFilter()
    for k in range(50):
        for one in (filter_, clean):
            one.rate(k * 10_000_000, 0.1)
            one.pose(k * 10_000_000, 0.0, 0.0, 0.001 * k)
        filter_.rate(k * 10_000_000, float("nan"))
    assert filter_.rejected == {"gyro not finite": 50}
    np.testing.assert_array_equal(filter_.heading.x, clean.heading.x)


def test_late_and_interleaved_samples_are_put_in_order():
    merged, sorted_ = BaseFilter(), BaseFilter()
    samples = [(k * 10_000_000, (0.001 * k, 0.0, 0.0)) for k in range(50)]
    lagging = [samples[k ^ 1] for k in range(50)]
    a = [e for t, pose in samples for e in sorted_.pose(t, *pose)]
    b = [e for t, pose in lagging for e in merged.pose(t, *pose)]
    k = min(len(a), len(b))
    assert k > 40
    np.testing.assert_array_equal([e.pose for e in a[:k]], [e.pose for e in b[:k]])
    merged.pose(10_000_000, 0.0, 0.0, 0.0)
    assert merged.rejected == {"late": 1}
