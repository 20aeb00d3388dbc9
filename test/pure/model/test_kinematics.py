import math

import numpy as np
import pytest
from model_arms import random_arm, random_states
from numpy.testing import assert_allclose

from fss_arm_model import kinematics
from fss_arm_model.layout import kinematic_index

STEP = 1e-6  # of central differences; their error is about STEP^2 and 1e-16 / STEP
TOLERANCE = 1e-8


def central(function, x):
    """Derivative of function(x) by the last dimension of x, one state."""
    steps = STEP * np.eye(x.size)
    return np.moveaxis((function(x + steps) - function(x - steps)) / (2.0 * STEP), 0, -1)


def test_one_link_by_hand():
    arm = random_arm(1, np.random.default_rng(0))
    link, (x, y, turn) = arm.links[0], arm.base.mount
    q = np.array([1.0, 2.0, math.pi / 2, -math.pi / 2 - turn])  # base turned left, link along x
    joints = kinematics.joint_positions(arm.vector(), q)
    assert_allclose(joints, [[1.0 - y, 2.0 + x], [1.0 - y + link.a, 2.0 + x]], atol=1e-14)
    base, body = kinematics.com_positions(arm.vector(), q)
    assert_allclose(base, [1.0 - arm.base.com[1], 2.0 + arm.base.com[0]], atol=1e-14)
    assert_allclose(body, joints[0] + [link.g, link.lateral], atol=1e-14)
    assert kinematics.tip_pose(arm.vector(), q)[2] == pytest.approx(arm.theta_E)


@pytest.mark.parametrize("n", [1, 4])
def test_tip_is_the_last_joint_and_its_jacobian_the_derivative(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    for q in random_states(n, 10, rng)[0]:
        assert_allclose(kinematics.tip_pose(p, q)[:2], kinematics.joint_positions(p, q)[-1])
        J = central(lambda q: kinematics.tip_pose(p, q), q)
        assert_allclose(kinematics.tip_jacobian(p, q), J, atol=TOLERANCE)


@pytest.mark.parametrize("n", [1, 4])
def test_regressor_is_the_derivative_by_the_parameters(n):
    rng = np.random.default_rng(n)
    p, index = random_arm(n, rng).vector(), kinematic_index(n)

    def pose(xi, q_m):
        changed = np.broadcast_to(p, (*xi.shape[:-1], p.size)).copy()
        changed[..., index] = xi
        return kinematics.tip_in_base(changed, q_m)

    for q in random_states(n, 10, rng)[0]:
        Phi = central(lambda xi, q_m=q[3:]: pose(xi, q_m), p[index])
        assert_allclose(kinematics.tip_regressor(p, q[3:]), Phi, atol=TOLERANCE)


def test_tip_in_base_does_not_depend_on_the_base():
    rng = np.random.default_rng(0)
    p, (q, *_) = random_arm(4, rng).vector(), random_states(4, 1, rng)
    x, y, heading = kinematics.tip_in_base(p, q[0, 3:])
    world = kinematics.tip_pose(p, q[0])
    c, s = math.cos(q[0, 2]), math.sin(q[0, 2])
    assert_allclose(world[:2] - q[0, :2], [c * x - s * y, s * x + c * y])
    assert world[2] == pytest.approx(heading + q[0, 2])
