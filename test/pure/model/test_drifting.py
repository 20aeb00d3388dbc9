"""The drift of base and arm as one body, beside scipy's integration of its equations."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from fss_arm_model.drifting import drift

BODY = np.array([21.5, 1.4, 0.3, -0.1])
ACTING = np.array([2e-3, -1e-3, 0.001, 0.02, 0.05])


def integrated(body, shared, own, times):
    M, K, c = body[0], body[1], complex(*body[2:])
    g, (tau, kappa, d) = complex(*shared[:2]), shared[2:]

    def rate(_, s):
        turned = np.exp(1j * s[4]) * c
        v = complex(s[2], s[3]) - 1j * s[5] * turned
        a = g - d / M * v
        torque = tau - kappa * s[5] + d * (turned.conjugate() * v).imag
        return [s[2], s[3], a.real, a.imag, s[5], torque / K]

    lever = np.exp(1j * own[2]) * c
    z, u = complex(*own[:2]) + lever, complex(*own[3:5]) + 1j * own[5] * lever
    begin = [z.real, z.imag, u.real, u.imag, own[2], own[5]]
    s = solve_ivp(rate, (0.0, times[-1]), begin, "DOP853", times, rtol=1e-12, atol=1e-14).y
    x = s[0] + 1j * s[1] - np.exp(1j * s[4]) * c
    return np.column_stack([x.real, x.imag, s[4], s[5]])


@pytest.mark.parametrize("omega", [0.0, 0.05, -1.5])
def test_it_is_what_scipy_integrates(omega):
    own, times = np.array([0.1, -0.4, 2.0, 0.01, -0.02, omega]), np.arange(0.0, 60.0, 0.5)
    expected = integrated(BODY, ACTING, own, times)
    assert_allclose(drift(BODY, ACTING, own, times), expected, rtol=0, atol=1e-6)


def test_it_broadcasts():
    own = np.random.default_rng(0).normal(0.0, 0.1, (3, 2, 6))
    many = drift(BODY, ACTING, own, np.arange(5.0))
    assert many.shape == (3, 2, 5, 4)
    assert_allclose(many[2, 1], drift(BODY, ACTING, own[2, 1], np.arange(5.0)), rtol=0, atol=0)
