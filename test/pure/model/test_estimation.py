"""Statistics of residuals, and least squares beside an independent solution."""

import numpy as np
import pytest
from scipy.optimize import minimize as minimize_generally

from fss_arm_model.estimation.least_squares import Decomposition, Linear, minimize
from fss_arm_model.estimation.statistics import equivalent_error, probability


def test_probabilities_allow_for_deviations_that_were_estimated():
    assert probability(12.0, 3) < probability(12.0, 3, 20.0) < probability(12.0, 3, 10.0)
    assert probability(12.0, 3, 1e9) == pytest.approx(probability(12.0, 3))
    assert equivalent_error(5.0, 3.0, np.inf) == 5.0
    assert equivalent_error(5.0, 3.0, 1e9) == pytest.approx(5.0)
    assert 3.0 < equivalent_error(5.0, 3.0, 10.0) < 4.0


def test_a_step_and_its_covariance_are_those_of_the_normal_equations():
    rng = np.random.default_rng(1)
    A, y = rng.standard_normal((30, 4)) * [1.0, 1e3, 1e-3, 1.0], rng.standard_normal(30)
    basis = Decomposition.of(A)
    assert basis.step(y) == pytest.approx(np.linalg.lstsq(A, y)[0], rel=1e-9)
    assert basis.covariance() @ (A.T @ A) == pytest.approx(np.eye(4), abs=1e-6)


def linear_problem(A, y):
    """Return the function that linearizes y - A x."""
    return lambda x: Linear(y - A @ x, A, np.asarray(np.sum((y - A @ x) ** 2)))


def test_a_minimum_within_bounds_is_that_of_a_general_solver():
    """Many bounds are active, and correlated columns make some of them inactive again."""
    rng, held = np.random.default_rng(2), 0
    for _ in range(100):
        A = rng.standard_normal((30, 8)) @ (np.eye(8) + 0.8 * rng.standard_normal((8, 8)))
        y, low, high = 3.0 * rng.standard_normal(30), np.full(8, -0.2), np.full(8, 0.3)
        found = minimize(linear_problem(A, y), np.zeros(8), (low, high))
        assert found.converged
        expected = minimize_generally(
            lambda x, A=A, y=y: 0.5 * np.sum((y - A @ x) ** 2),
            np.zeros(8),
            jac=lambda x, A=A, y=y: -A.T @ (y - A @ x),
            bounds=np.column_stack([low, high]),
            method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 10_000},
        )
        assert found.cost <= 2.0 * expected.fun * (1.0 + 1e-12)
        np.testing.assert_allclose(found.x, expected.x, atol=1e-5)  # gtol, by the curvature
        at_bound = np.isclose(found.x, low, atol=1e-12) | np.isclose(found.x, high, atol=1e-12)
        assert (found.at_bound == at_bound).all()
        held += found.at_bound.sum()
    assert held > 100


def test_large_residuals_do_not_keep_a_minimum_from_converging():
    """With a sum of squares of 1e6, its changes in the last steps are below rounding errors."""
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 1000)
    y = np.exp(-3.0 * t) + 30.0 * rng.standard_normal(1000)

    def linearize(x):
        e = np.exp(-x[1] * t)
        r = y - x[0] * e
        return Linear(r, np.column_stack([e, -x[0] * t * e]), np.asarray(np.sum(r**2)))

    assert minimize(
        linearize, np.array([1.0, 2.0]), (np.array([0.0, 0.0]), np.full(2, 9.0))
    ).converged
