"""The solver on the truth ladder: perfect guess, perturbed guess, noise; and what it claims."""

from dataclasses import replace

import numpy as np
import pytest
from calib_maneuvers import ARM, NAMES, draw, maneuver, observe, problem, several, single_joint
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fss_arm_calib.dynamic.knowledge import Knowledge
from fss_arm_calib.dynamic.solve import solve
from fss_arm_model import dynamics
from fss_arm_model.choice import Choice
from fss_arm_model.description import paper_arm
from fss_arm_model.joint_path import stack
from fss_arm_model.parameters import to_vector, values

PRECISE = Knowledge(
    base_mass_deviation=0.02, base_inertia_deviation=0.005, base_com_deviation=0.002
)
EXACT = Knowledge(*10 * [0.0])


def at_rest(count):
    return np.zeros((count, 8))


def perturbed(arm, words, size, seed=0):
    """A guess whose chosen parameters are off by so much of their value (lengths: of 0.2 m)."""
    choice, rng = Choice.of(words, arm.n), np.random.default_rng(seed)
    scale = np.where(choice.basis.any(axis=1), np.maximum(np.abs(values(arm)), 0.05), 0.0)
    v = values(arm) + size * scale * rng.uniform(-1.0, 1.0, len(scale))
    links = tuple(
        replace(link, mass=v[14 + i], b=v[18 + i], inertia=v[22 + i])
        for i, link in enumerate(arm.links)
    )
    base = replace(arm.base, mass=v[0], inertia=v[1], com=tuple(v[2:4]))
    return replace(arm, links=links, base=base)


@pytest.mark.parametrize(
    ("words", "heading_only"),
    [("I", True), ("b_i I_i", True), (NAMES, False)],
)
def test_the_truth_comes_back_from_a_wrong_guess(words, heading_only):
    path, free = several(16), len(Choice.of(words, 4).names)
    for seed in range(2):
        guess = perturbed(ARM, words, 0.3, seed)
        given = {"momentum": np.zeros(3), "tilt": 0.0, "prior": np.full(free, np.inf)}
        known = problem(path, guess, words, EXACT, heading_only, **given)
        result = solve(observe(known, ARM.vector(), at_rest(16)))
        assert result.minimum.converged
        assert not result.at_bound
        truth = replace(known, arm=ARM).guess
        assert_allclose(result.values, truth, rtol=0, atol=1e-8)


def test_momentum_tilt_and_start_are_found_with_the_parameters():
    rng, known = np.random.default_rng(1), problem(several(16), momentum=np.full(3, np.inf))
    _, _, states = draw(replace(known, momentum=np.array([0.3, 0.3, 0.1])), rng)
    result = solve(observe(replace(known, tilt=1.0), ARM.vector(), states))
    assert result.minimum.converged
    assert_allclose(result.momenta, states[:, 3:6], rtol=0, atol=1e-5)
    assert_allclose(result.values[-2:], states[0, 6:], rtol=0, atol=1e-5)
    assert result.problem.names[-2:] == ("g_x", "g_y")


def test_a_base_that_turns_from_the_start():
    """By up to three turns a maneuver: without bounds, the first step must not lead astray."""
    known, turning = problem(several(16), tilt=0.0, momentum=np.array([1.0, 1.0, 1.0])), at_rest(16)
    for seed in range(2):
        turning[:, 5] = np.random.default_rng(seed).uniform(-1.0, 1.0, 16)
        result = solve(observe(known, perturbed(ARM, NAMES, 0.1, seed).vector(), turning), False)
        assert result.minimum.converged
        assert_allclose(result.momenta, turning[:, 3:6], rtol=0, atol=0.02)


def test_a_sweep_that_turns_the_base_by_more_than_half_a_turn():
    path = stack(
        [maneuver(np.array([-q, q]), marks=1) for q in np.array([[1.5] * 4, [1.5, 1.4, 1, 1]])]
    )
    known = problem(path, words="I", heading_only=True, momentum=np.zeros(3), tilt=0.0)
    exact = observe(known, ARM.vector(), at_rest(2))
    assert np.ptp(exact.poses[..., 2], axis=1).min() > np.pi
    guess = perturbed(ARM, "I", 0.5)
    assert solve(replace(exact, arm=guess)).values == pytest.approx([0.034], abs=1e-10)


@pytest.mark.parametrize(
    ("words", "count", "maneuvers", "bound"),
    [
        (NAMES, 30, 12, 0.2),  # the mean of e' P^-1 e / 13 has a deviation of 0.07
        *(
            pytest.param(words, 500, 16, 0.1, marks=pytest.mark.slow)
            for words in ("I", "b_i I_i", NAMES, "m_i b_i I_i I_0 com_0")
        ),
    ],
)
def test_errors_are_as_large_as_claimed(words, count, maneuvers, bound):
    """Assume parameters that are known so well that their effect is linear."""
    knowledge = Knowledge() if "com_0" in words else PRECISE
    base = problem(several(maneuvers), words=words, knowledge=knowledge)
    rng, found = np.random.default_rng(3), []
    for _ in range(count):
        errors, vector, states = draw(base, rng)
        result = solve(observe(base, vector, states, rng), bounded=False)
        assert result.minimum.converged
        basis = base.choice.basis
        error = result.values - base.guess
        error -= [*(basis.T @ errors / basis.sum(axis=0)), *states[0, 6:]]
        nees = error @ np.linalg.solve(result.covariance, error) / len(error)
        chi_square = result.chi_square / base.degrees_of_freedom
        found.append((nees, chi_square, np.mean(result.checks[1] ** 2)))
    nees, chi_square, held_out = np.mean(found, axis=0)
    assert nees == pytest.approx(1.0, abs=bound)
    assert chi_square == pytest.approx(1.0, abs=0.45 / count**0.5)
    assert held_out == pytest.approx(1.0, abs=0.45 / count**0.5)


def test_a_wrong_assumption_shifts_the_estimate_by_its_bias():
    known = problem(several(16), words="b_i I_i", tilt=0.0, momentum=np.zeros(3))
    exact = observe(known, ARM.vector(), at_rest(16))
    result = solve(exact)
    assert set(result.assumed_names) >= {"m_0", "I_0", "x_com", "a_1", "theta_0_4", "m_3"}
    sigma = np.sqrt(np.diag(known.assumed))
    for k, name in enumerate(result.assumed_names):
        error = np.zeros(len(sigma))
        error[result.problem.uncertain[k]] = 1e-3 * sigma[result.problem.uncertain[k]]
        moved = observe(known, ARM.vector() + to_vector(4) @ error, at_rest(16))
        shift = (solve(moved).values - result.values) / 1e-3
        assert_allclose(shift, result.bias[:, k], rtol=0.02, atol=2e-5, err_msg=name)
    assert (result.deviations >= np.sqrt(np.diag(result.random))).all()


def test_what_came_from_the_prior_is_told():
    result = solve(observe(problem(several(16)), ARM.vector(), at_rest(16)))
    share = dict(zip(result.problem.names, result.prior_share, strict=True))
    assert share["b_1"] == share["I_4"] == 0.0
    assert 0.0 < share["x_com"] < 0.1 < share["I_0"] < 1.0
    heavy = replace(result.problem, prior=1e3 * result.problem.prior)
    assert solve(heavy).prior_share.max() < 0.01


def test_held_out_errors_are_those_of_predictions_from_the_others():
    known = problem(several(10), ARM, "b_i I_i", EXACT, tilt=0.0, momentum=np.zeros(3))
    known = replace(known, prior=np.full(8, np.inf))
    noisy = observe(known, ARM.vector(), at_rest(10), np.random.default_rng(6))
    leverage, error = solve(noisy).checks
    assert (leverage > 0.0).all()
    assert leverage.sum() < 8.0 + 1.0  # parameters estimated; none is assumed
    rest = solve(noisy.select(np.arange(10) != 3))
    one = replace(noisy.select(np.array([3])), arm=rest.calibrated())
    linear = one.eliminate_states(one.start, one.to_model)
    spread = linear.regressor @ rest.random @ linear.regressor.T + np.eye(len(linear.residuals))
    away = linear.residuals @ np.linalg.solve(spread, linear.residuals)
    assert np.sqrt(away / one.freedom_by_maneuver[0]) == pytest.approx(error[3], rel=0.02)


def test_a_solution_at_a_bound_says_so():
    heavy_tip = replace(ARM.links[3], b=-0.05)
    truth = replace(ARM, links=(*ARM.links[:3], heavy_tip))
    known = problem(several(16), words="b_i I_i", tilt=0.0, momentum=np.zeros(3))
    exact = observe(known, truth.vector(), at_rest(16))
    bounded = solve(exact)
    assert bounded.minimum.converged
    assert bounded.at_bound == ("b_4",)
    assert bounded.calibrated().links[3].b == pytest.approx(0.0, abs=1e-12)
    free = solve(exact, bounded=False)
    assert free.values[3] == pytest.approx(-0.05, abs=1e-6)
    assert free.at_bound == ()


def test_the_paper_s_fit_is_that_of_scipy_on_an_ode():
    """Common inertia and b from headings, beside least_squares over integrated base motion."""
    path = single_joint()
    known = problem(path, words="I", heading_only=True, tilt=0.0, momentum=np.zeros(3))
    noisy = observe(known, ARM.vector(), at_rest(8), np.random.default_rng(7))
    ends = [[np.arctan2(m[:-2:1][1::2], m[:-2:1][0::2]) for m in one] for one in path.marks]
    ends = np.diff(np.array(ends), axis=-1, prepend=0.0)  # joint readings at both marks

    def turned(inertia, q0, q1):
        p = ARM.vector()
        p[11::6] = inertia

        def rate(s, theta):
            H = dynamics.inertia_matrix(p, [0.0, 0.0, theta[0], *(q0 + s * (q1 - q0))])
            return np.linalg.solve(H[:3, :3], -H[:3, 3:] @ (q1 - q0))[2:]

        return solve_ivp(rate, (0.0, 1.0), [0.0], rtol=1e-11, atol=1e-12).y[0, -1]

    seen = np.diff(noisy.poses[..., 2], axis=1)[:, 0]
    peer = least_squares(
        lambda x: [s - turned(x[0], *e) for s, e in zip(seen, ends, strict=True)],
        [0.02],
        xtol=1e-12,
    )
    assert solve(noisy).values == pytest.approx(peer.x, abs=1e-7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poses": np.zeros((3, 2, 3))}, r"poses has shape \(3, 2, 3\), expected \(4, 8, 3\)"),
        ({"poses": np.full((4, 8, 3), np.nan)}, "a pose is not finite"),
        ({"sigma": np.full((4, 8, 3), np.inf)}, "no heading is observed"),
    ],
)
def test_impossible_problems_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(problem(several(4)), **change)


@pytest.mark.parametrize(
    ("words", "n", "names"),
    [
        ("I", 4, ("I",)),
        ("b_i I_0", 2, ("b_1", "b_2", "I_0")),
        ("com_0 mount", 1, ("x_com", "y_com", "x_BJ1", "y_BJ1", "theta_BJ1")),
        ("theta_0_i m_3", 3, ("theta_0_2", "theta_0_3", "m_3")),
    ],
)
def test_choices_by_words(words, n, names):
    assert Choice.of(words, n).names == names


def test_to_vector_follows_the_description():
    arm, moved = paper_arm(), perturbed(paper_arm(), "m_i b_i I_i m_0 I_0 com_0", 0.1)
    change = to_vector(4) @ (values(moved) - values(arm))
    assert_allclose(arm.vector() + change, moved.vector(), rtol=0, atol=1e-14)
    longer = arm.with_kinematics(values(arm)[4:14] + 0.01)
    change = to_vector(4) @ (values(longer) - values(arm))
    assert_allclose(arm.vector() + change, longer.vector(), rtol=0, atol=1e-14)
