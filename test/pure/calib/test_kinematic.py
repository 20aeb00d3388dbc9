"""The solver on the truth ladder: perfect guess, perturbed guess, noise, degenerate data."""

from dataclasses import replace

import numpy as np
import pytest
from calib_maneuvers import arm_of

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import EQUAL, FULL, KinematicProblem
from fss_arm_calib.kinematic.solve import NotIdentifiable, solve
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.estimation.least_squares import CAUCHY, HUBER, SQUARE
from fss_arm_model.kinematics import reading_jacobian, tip_in_base
from fss_arm_model.layout import kinematic_names
from fss_arm_model.planar import wrap

HALF_COUNT = np.pi / 240_000


def postures(n: int, count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (count, n))


def problem(arm: Arm, q: np.ndarray, parametrization: str, guess: Arm | None = None, **known):
    tip = tip_in_base(arm.vector(), q)
    tip[:, 2] = wrap(tip[:, 2])
    return KinematicProblem(q, tip, guess or arm, parametrization, **known)


def seen(exact: KinematicProblem, rng: np.random.Generator) -> KinematicProblem:
    """The problem with errors of its deviations."""
    return replace(exact, tip=exact.tip + rng.normal(size=exact.tip.shape) * exact.sigma)


def perturbed(arm: Arm, rng: np.random.Generator, length: float, angle: float) -> Arm:
    """A guess off by up to so much [m, rad] in every parameter."""
    names = kinematic_names(arm.n)
    size = np.where([name.startswith("theta") for name in names], angle, length)
    values = problem(arm, postures(arm.n, 1), FULL).guess
    return arm.with_kinematics(values + size * rng.uniform(-1.0, 1.0, len(names)))


@pytest.mark.parametrize("n", [1, 2, 4, 8])
def test_the_truth_comes_back_from_a_wrong_guess(n):
    truth, rng = arm_of(n), np.random.default_rng(n)
    for _ in range(5):
        guess = perturbed(truth, rng, length=0.1, angle=0.5)
        result = solve(problem(truth, postures(n, 3 * n + 4), FULL, guess))
        assert result.minimum.converged
        assert result.calibrated().base.mount == pytest.approx(truth.base.mount, abs=1e-9)
        for found, link in zip(result.calibrated().links, truth.links, strict=True):
            assert (found.a, found.theta_0) == pytest.approx((link.a, link.theta_0), abs=1e-9)


def test_the_iteration_alone_converges_where_the_closed_form_has_too_few_postures():
    """Four postures: 12 equations for 8 parameters, but the positions alone do not suffice."""
    truth, rng = paper_arm(), np.random.default_rng(3)
    q = np.radians([[10, -50, 70, 20], [-60, 80, -30, 60], [75, 35, 45, -80], [-20, -70, -65, -40]])
    for _ in range(50):
        guess = perturbed(truth, rng, length=0.03, angle=0.2)
        result = solve(problem(truth, q, EQUAL, guess), max_condition=1e5)
        assert result.minimum.converged
        assert np.abs(result.values - problem(truth, q, EQUAL).guess).max() < 1e-9


@pytest.mark.parametrize("parametrization", [FULL, EQUAL])
@pytest.mark.parametrize("draws", [5, pytest.param(25, marks=pytest.mark.slow)])
def test_a_thousand_random_starts_lead_to_the_same_minimum(parametrization, draws):
    """Angles anywhere, lengths of either sign, the paper's noise; 500 of each if slow."""
    rng = np.random.default_rng(7)
    exact = problem(paper_arm(), DEFAULT_POSTURES, parametrization)
    for _ in range(draws):
        noisy = seen(exact, rng)
        expected = solve(noisy)
        angles = np.array(exact.units) == "rad"
        for _ in range(20):
            start = np.where(angles, np.pi, 0.5) * rng.uniform(-1.0, 1.0, len(angles))
            found = solve(noisy, start=start)
            assert found.minimum.converged
            assert np.abs(found.values - expected.values).max() < 1e-7
            assert found.chi_square == pytest.approx(expected.chi_square, rel=1e-9)


@pytest.mark.parametrize("theta_e", [False, True])
@pytest.mark.parametrize("turned", [(0,), (1, 2), (3,)])
def test_mirrored_arms_are_recognized_and_folded_back(turned, theta_e):
    """A link of negative length, turned by pi, ends where the true one does."""
    exact = problem(paper_arm(), DEFAULT_POSTURES, FULL, theta_e=theta_e)
    values = model.all_parameters(exact, exact.guess)
    headings = np.cumsum([values[-2], *values[4:7]])
    headings[list(turned)] += np.pi
    values[list(turned)] *= -1.0
    values[4:7], values[-2] = np.diff(headings), headings[0]
    values[-1] -= np.pi * (3 in turned)
    mirrored = model.estimated_parameters(exact, values)
    assert model.is_mirrored(exact, mirrored)
    assert np.abs(model.residuals(exact, mirrored)[:, :2]).max() < 1e-12
    assert np.abs(model.unmirror(exact, mirrored) - exact.guess).max() < 1e-12
    # A last link turned by pi does not fit without a heading offset to turn it back.
    fits = theta_e or 3 not in turned
    assert (np.abs(model.residuals(exact, mirrored)[:, 2]).max() < 1e-12) == fits
    result = solve(exact, start=mirrored)
    assert np.abs(result.values - exact.guess).max() < 1e-9


def test_the_regressor_holds_the_derivatives_of_the_predictions():
    exact = problem(paper_arm(), DEFAULT_POSTURES, FULL, theta_e=True)
    xi, h = exact.guess + 0.01, 1e-6
    for column, step in zip(model.regressor(exact, xi).T, h * np.eye(len(xi)), strict=True):
        change = model.residuals(exact, xi - step) - model.residuals(exact, xi + step)
        slope = model.whiten_residuals(exact, change).ravel() / (2.0 * h)
        assert column == pytest.approx(slope, abs=1e-6)


def test_a_turned_subject_biases_the_last_offset_unless_it_is_estimated():
    turned = replace(paper_arm(), theta_E=np.radians(2.0))
    biased = solve(problem(turned, DEFAULT_POSTURES, EQUAL, paper_arm()))
    assert np.degrees(biased.values[4]) > -1.391 + 2.0
    known = problem(turned, DEFAULT_POSTURES, EQUAL, paper_arm(), theta_e=True)
    found = solve(known)
    assert known.names[-1] == "theta_E"
    assert known.units[-1] == "rad"
    assert np.degrees(found.values[[4, -1]]) == pytest.approx([-1.391, 2.0], abs=1e-7)
    assert found.calibrated().theta_E == found.values[-1]
    # Where it is known and not estimated, it is kept.
    assert solve(problem(turned, DEFAULT_POSTURES, EQUAL)).calibrated().theta_E == turned.theta_E


@pytest.mark.parametrize("loss", [HUBER, CAUCHY])
def test_a_robust_loss_bears_outliers(loss):
    rng = np.random.default_rng(11)
    exact, ratios = problem(paper_arm(), DEFAULT_POSTURES, EQUAL), []
    for _ in range(20):
        tip = seen(exact, rng).tip
        wrong = rng.choice(len(tip), 2, replace=False)
        tip[wrong] += rng.choice([-1.0, 1.0], (2, 3)) * [0.3, 0.3, 0.5]
        far, near = (solve(replace(exact, tip=tip, loss=kind)) for kind in (SQUARE, loss))
        assert near.minimum.converged
        away = [np.abs(r.values - exact.guess) / near.deviations for r in (far, near)]
        assert away[1].max() < 5.0
        ratios.append(np.linalg.norm(away[0]) / np.linalg.norm(away[1]))
        assert near.weights[wrong].max() < 0.3 < np.median(near.weights)
        assert set(np.argsort(near.normalized_residuals)[-2:]) == set(wrong)
    assert np.median(ratios) > 3.0


def test_leverage_and_normalized_residuals_tell_what_they_say():
    """Leverages add up to p / 3; correct residuals and predictions are chi-square of 3 degrees."""
    rng = np.random.default_rng(13)
    exact = problem(paper_arm(), DEFAULT_POSTURES, EQUAL)
    inside, outside = [], []
    kept = np.arange(13) % 4 != 3
    for _ in range(100):
        noisy = seen(exact, rng)
        result = solve(noisy)
        assert np.sum(result.leverage) == pytest.approx(8 / 3)
        assert 0.0 < result.leverage.min() < result.leverage.max() < 1.0
        inside.append(result.normalized_residuals**2)
        outside.append(solve(noisy.select(kept)).predict(noisy.select(~kept))[1] ** 2)
    for squares in (inside, outside):
        assert np.mean(squares) == pytest.approx(3.0, rel=0.08)
        assert np.mean(squares, axis=0) == pytest.approx(np.full(len(squares[0]), 3.0), rel=0.25)


@pytest.mark.parametrize("size", [1e-8, 1e-5, 1e-3])
def test_it_converges_where_rounding_hides_the_gain_of_the_last_steps(size):
    rng, cad = np.random.default_rng(5), perturbed(arm_of(4), np.random.default_rng(6), 0.02, 0.1)
    for _ in range(40):
        exact = problem(arm_of(4), postures(4, 20), FULL, cad)
        off = replace(exact, tip=exact.tip + size * rng.standard_normal(exact.tip.shape))
        assert solve(off).minimum.converged


def test_parameters_are_counted_and_named_as_the_paper_does():
    q = postures(4, 13)
    assert len(problem(paper_arm(), q, FULL).names) == 2 * 4 + 2
    equal, offsets = problem(paper_arm(), q, EQUAL), ("theta_0_2", "theta_0_3", "theta_0_4")
    assert equal.names == ("a", "a_4", *offsets, "x_BJ1", "y_BJ1", "theta_BJ1")
    assert problem(arm_of(2), postures(2, 8), EQUAL).names[:2] == ("a_1", "a_2")
    assert equal.units == ("m", "m", "rad", "rad", "rad", "m", "m", "rad")
    assert equal.guess[:2] == pytest.approx([0.3825, 0.3351], abs=1e-15)


@pytest.mark.parametrize("parametrization", [FULL, EQUAL])
@pytest.mark.parametrize(
    ("trials", "bound"), [(250, 0.1), pytest.param(1000, 0.05, marks=pytest.mark.slow)]
)
def test_errors_are_as_large_as_the_covariance_says(parametrization, trials, bound):
    """Normalized estimation error squared, within 3 deviations of its mean; the residuals."""
    rng = np.random.default_rng(2016)
    truth = paper_arm()
    guess = perturbed(truth, rng, length=0.02, angle=0.15)
    exact = problem(truth, DEFAULT_POSTURES, parametrization)
    squares, position, heading = [], [], []
    for _ in range(trials):
        result = solve(replace(seen(exact, rng), arm=guess))
        assert result.minimum.converged
        error = result.values - exact.guess
        squares.append(error @ np.linalg.solve(result.covariance, error))
        position.append(result.position_residual)
        heading.append(result.heading_residual)
    assert np.mean(squares) == pytest.approx(len(exact.names), rel=bound)
    if parametrization == EQUAL:
        assert np.mean(position) == pytest.approx(0.015, abs=0.0005)
        assert np.degrees(np.mean(heading)) == pytest.approx(0.683, abs=0.02)


ONE = postures(4, 1)


@pytest.mark.parametrize(
    ("q", "named", "not_named"),
    [
        # one posture, however often, gives three numbers
        (np.repeat(ONE, 13, axis=0), ("a_1", "a_4", "theta_0_2", "x_BJ1", "theta_BJ1"), ()),
        # a joint that never moves makes its two links one
        (postures(4, 13) * [0, 1, 1, 1], ("a_1", "x_BJ1", "y_BJ1", "theta_BJ1"), ("a_3", "a_4")),
        (postures(4, 13) * [1, 0, 1, 1], ("a_1", "a_2", "theta_BJ1"), ("a_4", "x_BJ1", "y_BJ1")),
        (postures(4, 13) * [1, 1, 1, 0], ("a_3", "a_4"), ("a_1", "a_2", "x_BJ1", "y_BJ1")),
        (postures(4, 3), ("a_1", "a_4", "x_BJ1"), ()),
    ],
)
@pytest.mark.parametrize("jitter", [0.0, HALF_COUNT])
def test_what_cannot_be_told_apart_is_named(q, named, not_named, jitter):
    q = q + jitter * np.random.default_rng(5).uniform(-1.0, 1.0, q.shape)
    with pytest.raises(NotIdentifiable) as caught:
        solve(problem(paper_arm(), q, FULL))
    assert set(named) <= set(caught.value.parameters)
    assert not set(not_named) & set(caught.value.parameters)
    assert named[0] in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((13, 3))}, r"q has shape \(13, 3\), expected \(s, 4\)"),
        ({"tip": np.zeros((12, 3))}, r"tip has shape \(12, 3\), expected \(13, 3\)"),
        ({"tip": np.full((13, 3), np.nan)}, "not finite"),
        ({"parametrization": "half"}, "parametrization is 'half', expected 'full', 'equal' or"),
        ({"loss": "none"}, "loss is 'none', expected 'square', 'huber' or 'cauchy'"),
        ({"position_deviation": 0.0}, "position_deviation is 0.0, must be positive"),
        ({"eccentricity_deviation": -1.0}, "eccentricity_deviation is -1.0, must not be negative"),
    ],
)
def test_an_impossible_problem_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(problem(paper_arm(), postures(4, 13), FULL), **change)


def test_what_readings_add_is_the_covariance_of_what_they_move():
    """Against the covariance of all observations together, written out."""
    exact = problem(
        arm_of(3), postures(3, 12), FULL, ripple_deviation=4e-4, eccentricity_deviation=7e-4
    )
    result, xi = solve(exact), exact.guess
    Phi_q, s = reading_jacobian(model.vector(exact, xi), exact.q), len(exact.q)
    apart = exact.q[:, None] - exact.q
    k = 4e-4**2 * np.cos(60 * apart) + 7e-4**2 * np.cos(apart)
    S = np.einsum("kin,kln,ljn->kilj", Phi_q, k, Phi_q)
    S[np.arange(s), :, np.arange(s), :] += np.diag(exact.sigma**2)
    W = np.zeros((s, 3, s, 3))
    own = S[np.arange(s), :, np.arange(s), :]
    W[np.arange(s), :, np.arange(s), :] = np.linalg.inv(own)
    S, W = S.reshape(3 * s, -1), W.reshape(3 * s, -1)
    Phi = (
        model.regressor(replace(exact, ripple_deviation=0.0, eccentricity_deviation=0.0), xi)
        * np.tile(exact.sigma, s)[:, None]
    )
    gain = np.linalg.solve(Phi.T @ W @ Phi, Phi.T @ W)
    np.testing.assert_allclose(result.covariance, gain @ S @ gain.T, rtol=1e-6, atol=1e-15)
