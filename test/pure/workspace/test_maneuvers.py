"""Torques along paths, and maneuvers that do not turn the base."""

import numpy as np
import pytest
from model_arms import random_arm
from numpy.testing import assert_allclose

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import forward_dynamics
from fss_arm_model.momentum import momentum
from fss_arm_workspace.regions.fixed import joint_limits
from fss_arm_workspace.straight_path.paths import Rules, arch, states_along
from fss_arm_workspace.torque import effort_along
from fss_arm_workspace.zero_reaction import (
    angular_coupling,
    zero_reaction_maneuver,
    zero_reaction_rates,
)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_torques_drive_the_arm_along_the_path(base):
    """Forward dynamics with the torques give back the accelerations; a free base needs no force."""
    arm, rules = paper_arm(), Rules(base=base)
    s = np.linspace(0.0, 0.2, 81)
    states, rates = states_along(arm, arch(arm), 2.5, s, rules)
    effort = effort_along(arm, s, states, rates, 2.0)
    if base == "floating":
        assert np.abs(effort.reaction).max() < 1e-3 * effort.peak
    else:
        assert np.abs(effort.reaction).max() > 0.1 * effort.peak
    tau = np.concatenate([effort.reaction, effort.torque], axis=1)
    start = forward_dynamics(arm.vector(), states[0], np.zeros(7), tau[0])
    assert_allclose(start, 0.0, atol=1e-9)
    fast = effort.within(1.8)
    assert fast.peak == pytest.approx(1.8)
    again = effort_along(arm, s, states, rates, fast.duration)
    assert_allclose(again.torque, fast.torque, atol=1e-9)


@pytest.mark.parametrize("n", [2, 4, 6])
def test_zero_reaction_rates_do_not_turn_the_base(n):
    rng = np.random.default_rng(n)
    arm = random_arm(n, rng)
    q = rng.uniform(-1.0, 1.0, 3 + n)
    basis = zero_reaction_rates(arm, q)
    assert basis.shape == (n - 1, n)
    assert_allclose(basis @ basis.T, np.eye(n - 1), atol=1e-12)
    assert_allclose(basis @ angular_coupling(arm, q), 0.0, atol=1e-12)


def test_a_zero_reaction_maneuver_has_no_momentum_and_leaves_the_heading():
    arm, start = paper_arm(), arch(paper_arm())
    states = zero_reaction_maneuver(arm, start, [1.0, -1.0, 0.5, 0.0], 0.6, step=1e-3)
    assert len(states) == 601
    assert_allclose(states[:, 2], start[2], atol=0.0)
    middle = states[1:-1]
    rate = (states[2:] - states[:-2]) / 2e-3
    assert np.abs(momentum(arm.vector(), middle, rate)).max() < 1e-5
    assert np.linalg.norm(states[-1, 3:] - start[3:]) > 0.3


def test_a_zero_reaction_maneuver_ends_at_a_limit():
    arm = paper_arm()
    states = zero_reaction_maneuver(arm, arch(arm), [0.0, 1.0, 0.0, 0.0], 20.0)
    limits = joint_limits(arm)
    room = np.minimum(states[-1, 3:] - limits[:, 0], limits[:, 1] - states[-1, 3:])
    assert 0.0 <= room.min() < 0.01
