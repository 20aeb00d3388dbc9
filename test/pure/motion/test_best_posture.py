"""The best posture for a velocity, against exhaustive search."""

import numpy as np
import pytest
from model_oracles import pinocchio_tip_jacobian
from numpy.testing import assert_allclose
from workspace_oracle import exhaustive

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_motion.best_posture import BestPosture, best, velocity_ratio
from fss_arm_motion.limits import Limits, LimitSettings
from fss_arm_motion.plan import PlanError, Start


def free_start():
    """Bodies may pass through each other, as the exhaustive search lets them."""
    arm = paper_arm()
    settings = LimitSettings(base_radius=0.0, link_radius=0.0, margin=0.0)
    return Start(arm, np.zeros(4), limits=Limits.of(arm, settings))


def test_the_ratio_is_the_velocity_that_rates_of_norm_one_give():
    """Compute the ratio by Pinocchio's Jacobian and inertia matrix, and by trying rates."""
    arm, q = paper_arm(), np.random.default_rng(0).uniform(-1.0, 1.0, 4)
    J = pinocchio_tip_jacobian(arm, q, floating=True)[:2]
    u = np.array([np.cos(0.7), np.sin(0.7)])
    expected = 1.0 / np.sqrt(u @ np.linalg.solve(J @ J.T, u))
    assert velocity_ratio(arm, q, 0.7) == pytest.approx(expected, rel=1e-9)
    rates = np.linalg.pinv(J) @ u
    assert expected * np.linalg.norm(rates) == pytest.approx(1.0)


@pytest.mark.parametrize(("base", "direction"), [("floating", 0.8), ("fixed", 2.1)])
def test_at_a_place_nothing_exhaustive_is_better(base, direction):
    start, place = free_start(), (0.9, 0.3)
    q, ratio = best(start, BestPosture(direction, place, base))
    assert_allclose(tip_in_base(start.arm.vector(), q)[:2], place, atol=1e-6)
    assert not start.limits.outside(q)

    def measure(q):
        return velocity_ratio(start.arm, q, direction, base)

    found = exhaustive(start.arm, start.limits.bounds, complex(*place), measure)
    assert ratio > (1.0 - 1e-4) * found


@pytest.mark.parametrize(("base", "direction"), [("floating", 2.1), ("fixed", 0.0)])
def test_anywhere_nothing_on_a_grid_is_better(base, direction):
    start = free_start()
    _, ratio = best(start, BestPosture(direction, base=base))
    axis = np.linspace(-np.pi / 2, np.pi / 2, 17)
    q = np.stack(np.meshgrid(*[axis] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    w = velocity_ratio(start.arm, q, direction, base)
    tops, size = q[np.argsort(-w)[:40]], axis[1] - axis[0]
    for _ in range(12):  # finer around the best of them
        fine = np.linspace(-1.0, 1.0, 5)
        offsets = np.stack(np.meshgrid(*[fine] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
        near = (tops[:, None] + size * offsets).clip(-np.pi / 2, np.pi / 2)
        w = velocity_ratio(start.arm, near, direction, base)
        tops, size = near[np.arange(len(tops)), w.argmax(axis=1)], 0.6 * size
    assert ratio > (1.0 - 1e-4) * w.max()


def test_bodies_keep_apart_and_a_place_beyond_reach_is_said_to_be():
    start = Start(paper_arm(), np.zeros(4))
    q, _ = best(start, BestPosture(0.8, (0.5, 0.2)))
    assert start.gap(q) > start.limits.margin - 1e-6
    with pytest.raises(PlanError, match=r"place is \[3.0, 0.0\] m"):
        best(start, BestPosture(0.0, (3.0, 0.0)))
