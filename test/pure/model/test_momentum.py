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
def test_momentum_is_what_the_base_rows_of_the_inertia_matrix_say(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    q, qd, _ = random_states(n, 20, rng)
    x, y, about_origin = np.einsum("...ij,...j->i...", dynamics.inertia_matrix(p, q)[:, :3], qd)
    r = momentum.system_com(p, q) - q[:, :2]
    L = about_origin - (r[:, 0] * y - r[:, 1] * x)
    assert_allclose(momentum.momentum(p, q, qd), np.stack([x, y, L], axis=-1), atol=1e-12)


def test_joint_torques_change_no_momentum():
    """Runge-Kutta of 4th order over 1 s; halving the step divides its error by 16."""
    rng = np.random.default_rng(0)
    p = random_arm(4, rng).vector()
    q, qd, tau = (states[0] for states in random_states(4, 1, rng))
    qd, tau[:3] = 0.3 * qd, 0.0
    before, start = momentum.momentum(p, q, qd), momentum.system_com(p, q)
    x, step = np.concatenate([q, qd]), 1e-3

    def rate(x):
        return np.concatenate([x[7:], dynamics.forward_dynamics(p, x[:7], x[7:], tau)])

    for _ in range(1000):
        k1 = rate(x)
        k2 = rate(x + 0.5 * step * k1)
        k3 = rate(x + 0.5 * step * k2)
        k4 = rate(x + step * k3)
        x = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    assert_allclose(momentum.momentum(p, x[:7], x[7:]), before, atol=1e-8)
    drift = momentum.system_com(p, x[:7]) - start
    assert_allclose(drift, before[:2] / masses(p).sum(), atol=1e-8)


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


def test_generalized_jacobian_tends_to_that_of_a_held_base():
    rng = np.random.default_rng(0)
    p, q = random_arm(4, rng).vector(), random_states(4, 20, rng)[0]
    held = kinematics.tip_jacobian(p, q)[..., 3:]
    errors = []
    for heavier in (1e3, 1e6, 1e9):
        heavy = p.copy()
        heavy[:2] *= heavier
        errors.append(np.abs(momentum.generalized_jacobian(heavy, q) - held).max())
    assert errors[2] < 1e-7
    assert errors[0] / errors[1] == pytest.approx(1e3, rel=0.1)


def test_arms_and_states_broadcast():
    rng = np.random.default_rng(0)
    p = np.array([random_arm(3, rng).vector() for _ in range(2)])[:, None]
    q, qd, _ = random_states(3, 5, rng)
    assert momentum.system_com(p, q).shape == (2, 5, 2)
    assert momentum.momentum(p, q, qd).shape == (2, 5, 3)
    assert momentum.generalized_jacobian(p, q).shape == (2, 5, 3, 3)
