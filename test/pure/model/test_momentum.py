import numpy as np
import pytest
from model_arms import random_arm, random_states
from numpy.testing import assert_allclose

from fss_arm_model import dynamics, kinematics, momentum

STEP = 1e-6


def masses(p):
    return np.concatenate([p[:1], p[10::6]])


def inertias(p):
    return np.concatenate([p[1:2], p[11::6]])


@pytest.mark.parametrize("n", [1, 4, 8])
def test_momentum_is_the_sum_over_bodies(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    m = masses(p)[:, None]
    for q, qd, _ in zip(*random_states(n, 10, rng), strict=True):
        c = kinematics.com_positions(p, q)
        com = (m * c).sum(axis=0) / m.sum()
        assert_allclose(momentum.system_com(p, q), com)
        ahead, behind = (kinematics.com_positions(p, q + s * qd) for s in (STEP, -STEP))
        f = m * (ahead - behind) / (2.0 * STEP)
        r = c - com
        L = (r[:, 0] * f[:, 1] - r[:, 1] * f[:, 0] + inertias(p) * np.cumsum(qd[2:])).sum()
        assert_allclose(momentum.momentum(p, q, qd), [*f.sum(axis=0), L], atol=1e-6)


@pytest.mark.parametrize("n", [1, 4, 8])
def test_generalized_jacobian_is_the_tips_without_momentum(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    for q, qd, _ in zip(*random_states(n, 10, rng), strict=True):
        H = dynamics.inertia_matrix(p, q)
        qd[:3] = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ qd[3:])
        assert_allclose(momentum.momentum(p, q, qd), 0.0, atol=1e-12)
        twist = kinematics.tip_jacobian(p, q) @ qd
        assert_allclose(momentum.generalized_jacobian(p, q) @ qd[3:], twist, atol=1e-12)
