"""What can be told and what not: against the known structure of the problem."""

import numpy as np
import pytest
from calib_maneuvers import ARM, arm_of, observe, problem, several

from fss_arm_calib.dynamic.identifiability import (
    HARDLY_SEEN,
    INVISIBLE,
    VISIBLE,
    combinations,
    directions,
    invisible_directions,
)
from fss_arm_calib.dynamic.knowledge import Knowledge
from fss_arm_calib.dynamic.solve import solve
from fss_arm_model.choice import Choice
from fss_arm_model.parameters import combination_gradients

KNOWN = Knowledge()


def unseen(arm, words):
    choice = Choice.of(words, arm.n)
    return invisible_directions(arm, choice, np.ones(len(choice.names)))


@pytest.mark.parametrize("n", [1, 2, 6])
def test_of_3n_parameters_2n_plus_1_combinations_are_visible(n):
    arm = arm_of(n)
    rest = unseen(arm, "m_i b_i I_i")
    assert len(rest) == 3 * n - (2 * n + 1)
    # and what cannot be seen leaves those combinations as they are
    G = combination_gradients(arm)[1][:, 2 * n + 6 :]
    assert np.linalg.matrix_rank(G) == 2 * n + 1
    assert np.abs(G @ rest.T).max(initial=0.0) < 1e-8


def test_the_scale_of_all_masses_is_invisible():
    everything = "m_0 I_0 com_0 m_i b_i I_i"
    rest, choice = unseen(ARM, everything), Choice.of(everything, 4)
    assert len(rest) == 5
    v = [10, 0.25, *np.zeros(12), *np.full(4, 2.88), *np.zeros(4), *np.full(4, 0.034)]
    scaling = choice.basis.T @ v
    scaling[[name[0] in "bxy" for name in choice.names]] = 0.0
    assert np.linalg.norm(rest @ scaling) == pytest.approx(np.linalg.norm(scaling), abs=1e-9)


def test_with_weighed_masses_everything_else_is_visible():
    for words in ("I", "I_i", "b_i I_i", "b_i I_i I_0 com_0"):
        assert len(unseen(ARM, words)) == 0


@pytest.fixture(scope="module")
def everything():
    """All 3n link parameters with no prior."""
    known = problem(several(16), words="m_i b_i I_i", prior=np.full(12, np.inf))
    return solve(observe(known, ARM.vector(), np.zeros((16, 8)), np.random.default_rng(0)))


def test_what_cannot_be_told_has_no_deviation_and_its_combinations_have(everything):
    assert everything.minimum.converged
    assert np.isinf(everything.deviations[:12]).all()
    found = combinations(everything)
    assert [c.name for c in found] == ["m", "S_1", "S_2", "S_3", "S_4", "K_1", "K_2", "K_3", "K_4"]
    true = combination_gradients(ARM)[0]
    for c, value in zip(found, true, strict=True):
        assert np.isinf(c.before)
        assert abs(c.value - value) < 4.0 * c.deviation < np.inf
    kinds = [d.kind for d in directions(everything, KNOWN)]
    assert kinds.count(INVISIBLE) == 3
    assert kinds.count(HARDLY_SEEN) >= 1  # the scale, for one


def test_a_prior_closes_what_is_invisible():
    known = problem(several(16), words="m_i b_i I_i")
    result = solve(observe(known, ARM.vector(), np.zeros((16, 8))))
    assert np.isfinite(result.deviations).all()
    masses = [name.startswith("m_") for name in known.names]
    assert (result.prior_share[masses] > 0.9).all()
    assert sum(d.kind == INVISIBLE for d in directions(result, KNOWN)) == 3


def test_the_gain_says_how_much_better_than_before():
    """One direction alone: b_4 by data of known weight."""
    known = problem(several(8), words="b_4", tilt=0.0)
    result = solve(observe(known, ARM.vector(), np.zeros((8, 8))))
    (only,) = directions(result, KNOWN)
    assert only.gain == pytest.approx(KNOWN.b_deviation / np.sqrt(result.random[0, 0]), rel=1e-9)
    assert only.kind == VISIBLE
    assert only.text(known.names) == "+1.00 b_4"


def test_combinations_know_what_was_assumed():
    known = problem(several(8), words="I_i", prior=np.full(4, 0.01))
    result = solve(observe(known, ARM.vector(), np.zeros((8, 8))))
    found = {c.name: c for c in combinations(result)}
    assert found["m"].deviation == pytest.approx(2 * KNOWN.mass_deviation)
    along = np.hypot(KNOWN.b_deviation, KNOWN.length_deviation)
    S_4 = np.hypot(0.1671 * KNOWN.mass_deviation, 2.88 * along)
    assert found["S_4"].deviation == pytest.approx(S_4, rel=1e-3)
    assert found["K_4"].deviation < found["K_4"].before
