"""Statistics of residuals, and least squares beside an independent solution."""

import numpy as np
import pytest

from fss_arm_model.estimation.least_squares import Decomposition
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
