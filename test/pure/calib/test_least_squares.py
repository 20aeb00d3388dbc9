"""Many problems side by side, beside each of them alone."""

import numpy as np
import pytest

from fss_arm_calib.estimation.least_squares import Linear, minimize, minimize_all


def line(A, b):
    """Linear problems (N, m, p), as both solvers take them."""

    def near(x, which):
        r = b[which] - (A[which] @ x[..., None])[..., 0]
        return Linear(r, A[which], np.sum(r**2, axis=-1), absorbed=np.zeros(r.shape))

    return near


@pytest.mark.parametrize("rows", [6, 1])
def test_what_is_inseparable_is_left_to_who_has_more_patience(rows):
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((3, rows, 2)), rng.standard_normal((3, rows))
    A[1, :, 1] = 0.0  # says nothing of the second parameter
    near = line(A, b)
    found = minimize_all(near, np.zeros((3, 2)))
    assert [one is not None for one in found] == ([True, False, True] if rows > 1 else 3 * [False])
    for k, one in enumerate(found):
        alone = minimize(lambda x, k=k: near(x, k), np.zeros(2))
        assert alone.converged
        if one is not None:
            np.testing.assert_allclose(one.x, alone.x, rtol=1e-13)
