"""Gaps between bodies and to the table's edge, against sampled points of the bodies."""

from itertools import pairwise

import numpy as np
import pytest
from model_arms import random_arm, random_states

from fss_arm_model.clearance import clearance, edge_clearance
from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import joint_positions


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_gaps_are_those_between_points_of_the_bodies(n):
    rng = np.random.default_rng(n)
    p, q = random_arm(n, rng).vector(), random_states(n, 8, rng)[0]
    along = np.linspace(0.0, 1.0, 150)
    for state, gap in zip(q, clearance(p, q, 0.1, 0.03), strict=True):
        joints = joint_positions(p, state)
        lines = [a + along[:, None] * (b - a) for a, b in pairwise(joints)]
        own = [np.linalg.norm(x - state[:2], axis=1).min() - 0.13 for x in lines[1:]]
        others = [
            np.linalg.norm(a[:, None] - b, axis=2).min() - 0.06
            for i, a in enumerate(lines)
            for b in lines[i + 2 :]
        ]
        assert gap == pytest.approx(min(own + others), abs=5e-3)


def test_an_arm_rolled_up_collides_and_a_straight_one_does_not():
    p, rolled = paper_arm().vector(), np.array([0, 0, 0, 0.0, 1.55, 1.55, 1.55])
    assert clearance(p, rolled, 0.19, 0.06) < 0.0
    # Straight, links 1 and 3 are a link's length apart.
    assert clearance(p, np.zeros(7), 0.19, 0.06) == pytest.approx(0.3825 - 2 * 0.06, abs=1e-3)


def test_one_link_has_nothing_to_collide_with():
    p = random_arm(1, np.random.default_rng(0)).vector()
    assert clearance(p, np.zeros(4), 0.2, 0.1) == np.inf


def test_the_edge_is_as_far_as_the_outermost_body():
    p, q = paper_arm().vector(), np.zeros((3, 7))
    q[1, 0], q[2, 1] = 1.0, -1.9
    far = joint_positions(p, q[0])[-1, 0]
    expected = [2.0 - far - 0.06, 1.0 - far - 0.06, 2.0 - 1.9 - 0.19]
    np.testing.assert_allclose(edge_clearance(p, q, (4.0, 4.0), 0.19, 0.06), expected, atol=1e-12)
