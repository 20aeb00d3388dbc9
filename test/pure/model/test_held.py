"""A body in the gripper: where it is, how it moves, and what it adds to the last link."""

import numpy as np
import pytest
from model_arms import random_arm

from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import (
    Target,
    approach,
    combined_momentum,
    payload_jacobian,
    payload_pose,
    payload_state,
    with_payload,
)
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import momentum

TARGET = Target(mass=9.0, inertia=0.2, fixture=(0.15, 0.05, 0.3))


def drawn(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    q, qd = rng.uniform(-0.7, 0.7, (2, 3 + n))
    return p, q, qd, payload_pose(p, q, rng.uniform(-1.0, 1.0, 3))


@pytest.mark.parametrize("n", [1, 4])
def test_its_jacobian_is_the_derivative_of_its_pose(n):
    p, q, qd, place = drawn(n)
    step = 1e-6
    ahead, behind = (payload_state(p, q + sign * step * qd, qd, place)[0] for sign in (1.0, -1.0))
    moved = (ahead - behind) / (2.0 * step)
    np.testing.assert_allclose(payload_jacobian(p, q, place) @ qd, moved, atol=1e-8)


@pytest.mark.parametrize("n", [1, 4])
def test_arm_and_body_together_have_the_inertia_of_both(n):
    p, q, _, place = drawn(n)
    J = payload_jacobian(p, q, place)
    M = np.diag([TARGET.mass, TARGET.mass, TARGET.inertia])
    whole = inertia_matrix(with_payload(p, TARGET, place), q)
    np.testing.assert_allclose(whole, inertia_matrix(p, q) + J.T @ M @ J, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("n", [1, 4])
def test_a_body_that_moves_with_the_last_link_has_the_momentum_of_one_held(n):
    p, q, qd, place = drawn(n)
    both = combined_momentum(p, q, qd, TARGET, payload_state(p, q, qd, place))
    np.testing.assert_allclose(both, momentum(with_payload(p, TARGET, place), q, qd), atol=1e-12)


def test_the_fixture_is_met_straight_and_at_rest():
    p, q, qd, _ = drawn(4)
    x, y, heading = tip_pose(p, q)
    theta = heading + np.pi - TARGET.fixture[2]
    out = complex(*TARGET.fixture[:2]) * np.exp(1j * theta)
    place = payload_pose(p, q, [x - out.real, y - out.imag, theta])
    met = approach(p, q, qd, TARGET, payload_state(p, q, qd, place))
    np.testing.assert_allclose(met, 0.0, atol=1e-12)
