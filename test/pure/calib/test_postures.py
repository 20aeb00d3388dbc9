"""The postures to observe: informative, clear of each other, and in an order of short moves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fss_arm_calib.experiment.postures import (
    DEFAULT_POSTURES,
    MIN_DIFFERENCE,
    default_postures,
    design_postures,
    is_clear,
)
from fss_arm_calib.kinematic.problem import FULL, KinematicProblem
from fss_arm_calib.kinematic.solve import solve
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.guard.guard import Guard
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.kinematics import tip_in_base


def solution(arm: Arm, q: np.ndarray):
    return solve(KinematicProblem(q, tip_in_base(arm.vector(), q), arm, FULL))


def test_the_table_is_what_the_design_finds_and_more_informative_than_chance():
    rng, q = np.random.default_rng(0), design_postures(paper_arm(), seed=5)
    chances = [solution(paper_arm(), rng.uniform(-1.5, 1.5, (13, 4))) for _ in range(50)]
    found, table = solution(paper_arm(), q), solution(paper_arm(), DEFAULT_POSTURES)
    chance, designed = (
        min(np.linalg.slogdet(one.covariance)[1] for one in some) for some in (chances, [found])
    )
    assert np.linalg.slogdet(table.covariance)[1] <= min(designed + 0.5, chance)
    assert table.condition_number < 20.0


def test_the_table_can_be_run():
    assert len(DEFAULT_POSTURES) == 13
    assert np.abs(DEFAULT_POSTURES).max() <= np.pi / 2
    assert np.abs(DEFAULT_POSTURES[0]).max() < 0.2
    moves = np.abs(np.diff(DEFAULT_POSTURES, axis=0)).max(axis=1)
    assert moves.sum() / 0.8 < 45.0  # seconds of travel at 0.8 rad/s
    guard = Guard(paper_arm())
    assert guard.slack(DEFAULT_POSTURES).min() >= 0.0
    assert all(is_clear(guard, here, there) for here, there in pairwise(DEFAULT_POSTURES))


@pytest.mark.parametrize("n", [1, 3])
def test_any_arm_gets_postures_that_identify_it(n):
    arm = replace(paper_arm(), links=paper_arm().links[:n])
    q = default_postures(arm)
    assert q.shape == (max(13, 2 * n + 2), n)
    assert solution(arm, q).condition_number < 60.0
    apart = [np.abs(a - b).max() for k, a in enumerate(q) for b in q[:k]]
    assert min(apart) >= (MIN_DIFFERENCE if n > 2 else np.radians(4.0))


@pytest.mark.parametrize("change", [{"a": 0.28}, {"q_min": -1.2, "q_max": 1.2}])
def test_an_arm_of_four_links_that_cannot_take_the_table_gets_its_own_postures(change):
    arm = replace(paper_arm(), links=tuple(replace(k, **change) for k in paper_arm().links))
    q = default_postures(arm)
    assert not np.array_equal(q, DEFAULT_POSTURES)
    assert all(is_clear(Guard(arm), *move) for move in pairwise(q))
    assert np.abs(q).max() <= arm.links[0].q_max


def test_more_postures_than_one_joint_has_room_for_are_chosen_in_time():
    """Each that is exchanged makes another crowded, and so on for ever."""
    arm = replace(paper_arm(), links=paper_arm().links[:1])
    q = design_postures(arm, 30, candidates=200)
    assert q.shape == (30, 1)
    assert np.ptp(q) > np.radians(160.0)


def test_postures_leave_the_margin_asked_for():
    arm, wide = paper_arm(), GuardSettings(margin=0.2)
    near, far = (Guard(arm, wide).slack(design_postures(arm, 8, settings=s)) for s in (None, wide))
    assert near.min() < 0.0 <= far.min()
