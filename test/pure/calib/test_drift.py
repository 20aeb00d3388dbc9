"""What acts on the drifting base, against the simulated truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calib_drift import ARM, FRESH, SHARED, SIGMA, drifts, problem

from fss_arm_calib.drift.calibrate import check_time, solution_of
from fss_arm_calib.drift.problem import solve
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.drifting import single_body
from fss_arm_model.dynamics import kinetic_energy
from fss_arm_model.momentum import momentum


def test_the_rigid_body_has_the_arm_s_momentum_and_energy():
    q, twist = (0.3, -0.8, 1.1, 0.2), np.array([0.02, -0.01, 0.3])
    mass, inertia, *com = single_body(ARM.vector(), q)
    v = complex(*twist[:2]) + 1j * twist[2] * complex(*com)
    state, rate = np.array([0.0, 0.0, 0.0, *q]), np.array([*twist, 0.0, 0.0, 0.0, 0.0])
    expected = momentum(ARM.vector(), state, rate)
    P = mass * v
    np.testing.assert_allclose([P.real, P.imag, inertia * twist[2]], expected, rtol=1e-12)
    energy = 0.5 * (mass * abs(v) ** 2 + inertia * twist[2] ** 2)
    assert energy == pytest.approx(kinetic_energy(ARM.vector(), state, rate))


def test_derivatives_are_those_of_the_motion():
    found, _ = drifts(2, count=1)
    one = problem(found)
    x = one.start + np.concatenate([SHARED, np.zeros(8)])
    linear, step = one.linearize(x), np.zeros(13)
    step[:] = 1e-6 * np.random.default_rng(0).standard_normal(13)
    step[2] *= 0.01  # a torque moves the base far
    (up, *_), (down, *_) = one.sensitivities(x + step)[0], one.sensitivities(x - step)[0]
    by = one.sensitivities(x)[0].poses_by
    np.testing.assert_allclose(0.5 * (up - down), by @ step, rtol=1e-3, atol=1e-9)
    change = 0.5 * (one.linearize(x + step).cost - one.linearize(x - step).cost)
    along = -2.0 * linear.residuals @ linear.regressor @ step
    np.testing.assert_allclose(change, along, rtol=1e-3)


@pytest.mark.slow
def test_errors_are_as_large_as_the_deviations_say():
    """Tilt, what resists motion, mean torque and momenta, over 40 simulated floats."""
    shared, torques, momenta, costs = [], [], [], []
    for seed in range(40):
        found, truth = drifts(seed)
        result = solve(problem(found, seed))
        assert result.minimum.converged
        shared.append((result.values - SHARED) / np.sqrt(np.diag(result.covariance)))
        mean, deviation = result.hose_torque
        torques.append((mean - truth.hose_torque) / deviation)
        values, deviations = result.momenta
        momenta.append((values - truth.momenta) / deviations)
        costs.append(result.minimum.cost / result.problem.degrees_of_freedom)
    # The mean of 40 squares of deviation 1 is 1 +- 0.22.
    squares = np.mean(np.square(shared), axis=0)
    assert ((squares > 0.5) & (squares < 1.7)).all(), squares
    assert 0.5 < np.mean(np.square(torques)) < 1.7
    assert 0.8 < np.mean(np.square(momenta)) < 1.2
    assert np.mean(costs) == pytest.approx(1.0, abs=0.03)


def test_a_hose_that_twists_is_told_from_a_level_table():
    found, truth = drifts(3, tilt=(0.0, 0.0), tether=0.0, twist=0.01)
    result = solve(problem(found, 3))
    mean, deviation = result.hose_torque
    assert abs(truth.hose_torque) > 10.0 * deviation
    assert abs(mean - truth.hose_torque) < 4.0 * deviation
    assert (np.abs(result.values[:2]) < 4.0 * np.sqrt(np.diag(result.covariance)[:2])).all()


def test_an_error_of_the_masses_is_carried():
    found, _ = drifts(4)
    exact, loose = (solve(problem(found, 4, mass=mass)) for mass in (0.0, 0.05))
    mean, deviation = loose.hose_torque
    assert deviation == pytest.approx(np.hypot(exact.hose_torque[1], 0.05 * mean))
    np.testing.assert_array_equal(loose.covariance[:2, :2], exact.covariance[:2, :2])


def test_one_long_drift_may_decide_alone():
    found, _ = drifts(6, count=1, length=120.0)
    result = solve(problem(found, 6))
    leverage, errors, redundancy = result.cross_checks
    assert redundancy == 0.0  # and not a little below, by rounding
    assert 4.0 < leverage[0] <= 5.0  # of five unknowns
    assert errors[0] == pytest.approx(1.0, abs=0.15)  # of what is left of its own residuals


def test_errors_of_clean_drifts_are_about_1_and_a_noisy_drift_is_rejected():
    found, _ = drifts(7)
    clean = solution_of(found, ARM, DriftSettings())
    np.testing.assert_allclose(clean.errors, 1.0, atol=0.2)
    noise = 5.0 * SIGMA / np.sqrt(FRESH) * np.random.default_rng(7).standard_normal((80, 3))
    found[2] = replace(found[2], poses=found[2].poses + noise)
    solution = solution_of(found, ARM, DriftSettings(max_outliers=1))
    assert solution.kept.tolist() == [True, True, False, True]
    assert solution.errors[2] == pytest.approx(5.1, abs=0.5)


def test_a_little_too_little_time_is_not_rounded_up():
    drift = SimpleNamespace(times=np.array([0.0, 59.6]))
    check = check_time([drift], Streams(), DriftSettings())
    assert check.reason.startswith("59.6 s of drift, at least 60 s needed")
