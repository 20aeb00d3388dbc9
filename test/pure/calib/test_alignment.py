"""The clocks' offset from moves at constant acceleration, speed and deceleration."""

import numpy as np
import pytest
from calib_rig import ARM, POSTURES, Rig, feed

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.segments.alignment import (
    Alignment,
    Offset,
    estimate_offset,
    find_last_move,
    mean_offset,
)
from fss_arm_calib.segments.joints import Rests
from fss_arm_calib.segments.rests import RestFinder
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.units import SECOND

SPEED, ACCELERATION = 0.5, 1.0


def path(t: np.ndarray, turn: float) -> np.ndarray:
    """A joint's angle when it turns by `turn` from time 0 on."""
    size = abs(turn)
    ramp = min(SPEED / ACCELERATION, np.sqrt(size / ACCELERATION))
    length = size / (ACCELERATION * ramp) + ramp
    t = np.clip(t, 0.0, length)
    angle = np.where(t < ramp, 0.5 * ACCELERATION * t**2, ACCELERATION * ramp * (t - 0.5 * ramp))
    braking = size - 0.5 * ACCELERATION * (length - t) ** 2
    return np.sign(turn) * np.where(t > length - ramp, braking, angle)


def offset_seen(rng, delta, noise=0.0, n=4, search=1.0):
    """What is found of a random move whose joints' stamps are `delta` s late."""
    turns, start = rng.uniform(-2.0, 2.0, n), rng.uniform(0.0, 0.1, n)
    end = 2.0 / SPEED + SPEED / ACCELERATION + 0.1
    q = []
    for turn, begin in zip(turns, start, strict=True):
        t = np.arange(-3.0 + rng.uniform(0.0, 0.2), end + 1.5, 0.2)
        q.append((t + delta, path(t - begin, turn)))
    seen = np.arange(-3.0, end + 3.0, 0.01)
    psi = sum(path(seen - begin, turn) for turn, begin in zip(turns, start, strict=True))
    psi = 1.0 + psi + noise * rng.normal(size=len(seen))
    return estimate_offset(np.array([delta, end + delta]), q, seen, psi, search)


@pytest.mark.parametrize(("delta", "noise"), [(-0.7, 0.0), (0.0, 1e-3), (0.05, 1.2e-2)])
def test_the_offset_of_a_move_is_found_within_its_deviation(delta, noise):
    rng = np.random.default_rng(3)
    found = [offset_seen(rng, delta, noise) for _ in range(20)]
    known = [offset for offset in found if offset.deviation < np.inf]
    assert len(known) >= 17  # of the others all joints together hardly turned the end effector
    errors = np.array([offset.value - delta for offset in known])
    deviations = np.array([offset.deviation for offset in known])
    assert np.abs(errors).max() < 0.003 + noise
    assert np.mean((errors / deviations) ** 2) < 1.5
    assert np.median(deviations) < 0.0015 + noise


@pytest.mark.parametrize("n", [5, 30])
def test_the_deviation_of_the_mean_of_n_moves_is_true(n):
    """Of 300 moves, late by 0.05 s."""
    rng = np.random.default_rng(11)
    found = (offset_seen(rng, 0.05, 5e-3) for _ in range(340))
    many = [offset for offset in found if offset.deviation < 0.05][:300]
    rng, squares = np.random.default_rng(4), []
    for _ in range(1000):
        mean = mean_offset([many[i] for i in rng.integers(0, len(many), n)])
        squares.append(((mean.value - 0.05) / mean.deviation) ** 2)
    assert 0.6 < np.mean(squares) < 1.25


def test_what_tells_nothing_is_no_offset():
    rng = np.random.default_rng(5)
    assert not offset_seen(rng, 1.5).deviation < np.inf  # beyond the search
    t = np.arange(-2.0, 4.0, 0.2)
    turning, back = (t, path(t, 1.0)), (t, path(t, -1.0))
    seen = np.arange(-2.0, 4.0, 0.01)
    nothing = estimate_offset(np.array([0.0, 2.5]), [turning, back], seen, 0.0 * seen, 1.0)
    assert nothing.deviation == np.inf
    assert np.isnan(nothing.value)


def test_moves_that_contradict_each_other_widen_the_deviation():
    mean = mean_offset([Offset(0.0, 0.001), Offset(0.02, 0.001)])
    assert mean.value == pytest.approx(0.01)
    assert mean.deviation == pytest.approx(0.01)
    assert mean_offset([Offset(0.3, 0.002)]) == Offset(0.3, pytest.approx(0.002))


def one_joint():
    """What a joint that turns by 1 rad tells: the alignment, and `learn` that teaches a move."""
    alignment, t = Alignment(1.0), np.arange(-2.0, 4.0, 0.2)
    seen = np.arange(-2.0, 4.0, 0.01)

    def learn(psi, late=0.0):
        q = [(t, path(t, 1.0))]
        alignment.add_move(estimate_offset(np.array([0.0, 2.5]), q, seen - late, psi(seen), 1.0))

    return alignment, learn


def test_a_move_that_looks_like_another_tells_nothing():
    """An end effector that swings by itself fits best at some offset, however badly."""
    alignment, learn = one_joint()
    learn(lambda t: 0.1 * np.sin(3.0 * t))
    assert alignment.offset.deviation == np.inf
    learn(lambda t: path(t, 1.0), late=0.1)
    learn(lambda t: 0.1 * np.sin(3.0 * t))
    assert alignment.offset.value == pytest.approx(0.1, abs=0.003)


def rested(*times):
    """Two joints at rest but for moves of the first one that begin at such times [s]."""
    rests = Rests(2, 1e-3, 60 * SECOND)
    for k in range(150):
        at = 0.2 * k
        for i in (1, 2):
            q = sum(float(path(at - begin, 1.0)) for begin in times) if i == 1 else 0.5
            for _ in rests.add(i, round(at * SECOND), q):
                pass
    return rests.joints


def test_the_last_move_is_found():
    assert find_last_move(rested(), 29 * SECOND, 1e-3) is None
    begin, end = find_last_move(rested(1.0, 20.0), 29 * SECOND, 1e-3)
    assert (begin, end) == (20 * SECOND, pytest.approx(22.4 * SECOND, abs=0.2 * SECOND))
    assert find_last_move(rested(1.0, 20.0), 19 * SECOND, 1e-3)[0] == SECOND
    assert find_last_move(rested(1.0), 29 * SECOND, 1e-3) is None  # too long ago


def test_only_the_newest_moves_count():
    """A clock that is set anew is followed, and a day of moves is not kept."""
    alignment, learn = one_joint()
    for late in [0.3] * 150 + [0.1] * 100:
        learn(lambda t: path(t, 1.0), late)
    assert len(alignment.moves) == 100
    assert alignment.offset.value == pytest.approx(0.1, abs=0.003)


def observed(rig, late):
    """The finder and what it finds if all joints' stamps are late [s]."""
    finder, late = RestFinder(4), round(late * SECOND)
    shifted = (s._replace(t=s.t + late * isinstance(s.stream, int)) for s in rig.samples())
    return finder, feed(finder, shifted)


@pytest.mark.parametrize("late", [-0.9, 0.04])
def test_the_finder_allows_for_the_offset(late):
    """All joints' stamps are late: the windows of poses would reach into the next move."""
    rig = Rig(np.array([*POSTURES, *DEFAULT_POSTURES[:5]]), rest=2.6)
    finder, found = observed(rig, late)
    far = observed(rig, 3.0)[0].streams()
    assert (far.offset.deviation, far.offset_lower_bound) == (np.inf, 1.0)
    offset = finder.streams().offset
    assert finder.streams().offset_lower_bound == 0.0
    assert offset.value == pytest.approx(late, abs=0.003)
    assert offset.deviation < 0.003
    # Nothing had moved before the first rest, and its poses may be those of the move after it.
    assert found[0].time_offset == 0.0
    assert found[0].used or found[0].reason == "poses contradict each other"
    assert [o.used for o in found[1:]] == [True] * 7
    for observation, posture in zip(found[1:], rig.postures[1:], strict=True):
        assert observation.time_offset == pytest.approx(late, abs=0.005)
        assert observation.tip == pytest.approx(tip_in_base(ARM.vector(), posture), abs=1e-4)
