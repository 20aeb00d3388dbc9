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
def test_its_jacobian_is_the_derivative_and_gives_inertia_and_momentum_of_both(n):
    p, q, qd, place = drawn(n)
    step = 1e-6
    ahead, behind = (payload_state(p, q + sign * step * qd, qd, place)[0] for sign in (1.0, -1.0))
    moved = (ahead - behind) / (2.0 * step)
    J, M = payload_jacobian(p, q, place), np.diag([TARGET.mass, TARGET.mass, TARGET.inertia])
    np.testing.assert_allclose(J @ qd, moved, atol=1e-8)
    whole = with_payload(p, TARGET, place)
    expected = inertia_matrix(p, q) + J.T @ M @ J
    np.testing.assert_allclose(inertia_matrix(whole, q), expected, rtol=1e-10, atol=1e-10)
    both = combined_momentum(p, q, qd, TARGET, payload_state(p, q, qd, place))
    np.testing.assert_allclose(both, momentum(whole, q, qd), atol=1e-12)


def test_the_fixture_is_met_straight_and_at_rest():
    p, q, qd, _ = drawn(4)
    x, y, heading = tip_pose(p, q)
    theta = heading + np.pi - TARGET.fixture[2]
    out = complex(*TARGET.fixture[:2]) * np.exp(1j * theta)
    place = payload_pose(p, q, [x - out.real, y - out.imag, theta])
    met = approach(p, q, qd, TARGET, payload_state(p, q, qd, place))
    np.testing.assert_allclose(met, 0.0, atol=1e-12)
