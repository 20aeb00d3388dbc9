"""Gaps between bodies and to the table's edge, against sampled points of the bodies."""

from itertools import pairwise

import numpy as np
import pytest
from model_arms import random_arm, random_states

from fss_arm_model.clearance import (
    body_name,
    clearance,
    edge_clearance,
    gaps,
    links_and_base,
    sizes,
    with_edge,
    with_target,
)
from fss_arm_model.description import paper_arm
from fss_arm_model.extents import Extents
from fss_arm_model.kinematics import joint_positions

BED = Extents()
RADII = BED.base_radius, BED.link_radius


@pytest.mark.parametrize("n", [2, 6])
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
    alone = random_arm(1, rng).vector()
    assert clearance(alone, np.zeros(4), *RADII) == np.inf


def test_the_edge_is_as_far_as_the_outermost_body():
    p, q = paper_arm().vector(), np.zeros((3, 7))
    q[1, 0], q[2, 1] = 1.0, -1.9
    far = joint_positions(p, q[0])[-1, 0]
    expected = [2.0 - far - 0.06, 1.0 - far - 0.06, 2.0 - 1.9 - 0.19]
    np.testing.assert_allclose(edge_clearance(p, q, BED.table, *RADII), expected, atol=1e-12)


def test_gaps_stand_in_the_order_of_the_pairs_which_name_their_bodies():
    p, n = paper_arm().vector(), 4
    pairs = [*links_and_base(n), *with_edge(n), *with_target(n)]
    named = [(body_name(i, n), body_name(j, n)) for i, j in pairs]
    assert named[:3] == [("base", "link 2"), ("base", "link 3"), ("base", "link 4")]
    assert named[6] == ("base", "table edge")
    assert named[-1] == ("gripper", "target")
    tip = joint_positions(p, np.zeros(7))[-1]
    around = sizes(BED, target_radius=0.2, gripper_length=0.1)
    found = dict(zip(named, gaps(p, np.zeros(7), pairs, around, tip), strict=True))
    assert found["gripper", "target"] == pytest.approx(-0.2)
    assert found["link 4", "target"] == pytest.approx(0.1 - 0.06 - 0.2)
    assert found["base", "target"] == pytest.approx(np.hypot(*tip) - 0.19 - 0.2)
    joint = joint_positions(p, np.zeros(7))[2]
    assert found["link 3", "table edge"] == pytest.approx(2.0 - 0.06 - np.abs(joint).max())
