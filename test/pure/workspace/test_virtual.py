"""The virtual manipulator against the real arm on a free base."""

import numpy as np
import pytest
from model_arms import random_arm
from workspace_oracle import sampled

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import system_com
from fss_arm_workspace.regions.fixed import joint_limits
from fss_arm_workspace.regions.virtual import VirtualManipulator, base_mass_for


def from_com(arm, q):
    """Return the tip relative to the system's center of mass, with the base not turned."""
    p, q = arm.vector(), np.concatenate([np.zeros((len(q), 3)), q], axis=1)
    tip = tip_pose(p, q)[:, :2] - system_com(p, q)
    return tip[:, 0] + 1j * tip[:, 1]


def test_the_papers_radius():
    virtual = VirtualManipulator(paper_arm())
    assert virtual.radius == pytest.approx(1.172, abs=5e-4)
    assert virtual.radius == pytest.approx(virtual.b.sum() + virtual.g.sum())
    assert virtual.reach() == (0.0, pytest.approx(virtual.radius))
    b_2 = 0.191 * (10.0 + 2 * 2.88) / (10.0 + 4 * 2.88)
    g_2 = (0.3825 - 0.191) * (10.0 + 2.88) / (10.0 + 4 * 2.88)
    assert (virtual.b[2], virtual.g[2]) == pytest.approx((b_2, g_2))
    arm = paper_arm()  # straight, it reaches so far
    straight = -np.array([link.theta_0 for link in arm.links])
    straight[0] = np.arctan2(arm.base.mount[1], arm.base.mount[0]) - arm.base.mount[2]
    assert np.abs(from_com(arm, straight[None])) == pytest.approx(virtual.radius)


def test_the_base_mass_for_the_papers_radius():
    assert base_mass_for(paper_arm(), 1.3) == pytest.approx(17.07, abs=0.01)
    with pytest.raises(ValueError, match=r"radius is 2\.0 m, expected between .* and 1\.689 m"):
        base_mass_for(paper_arm(), 2.0)


@pytest.mark.parametrize("n", [1, 4])
def test_reach_agrees_with_brute_force(n):
    rng = np.random.default_rng(n)
    arm = random_arm(n, rng)
    virtual = VirtualManipulator(arm)
    tips = from_com(arm, sampled(arm.vector(), joint_limits(arm), 200_000, rng)[0])
    nearest, farthest = virtual.reach()
    assert farthest <= virtual.radius + 1e-12
    assert np.abs(tips).max() <= farthest + 1e-12
    assert np.abs(tips).min() >= nearest - 1e-12
    assert np.abs(tips).max() == pytest.approx(farthest, abs=0.02)
    assert np.abs(tips).min() == pytest.approx(nearest, abs=0.02)
    workspace = virtual.workspace()
    assert workspace.distance(tips[~workspace.contains(tips)]).max(initial=0.0) < 1e-12
